"""What passes of a spatial frequency, across and down [m^-1]: the type of functions that tell it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Transfer = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.complex128]]
