"""Standard deviation of each gray level of a relit image, by the tolerances that its basis tells.

As for a render, see `uncertainty`; but the sources' shares in a pixel are those
of the basis' own images, with all of the opening, not of the central ray alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.relight.relit import Basis, Relit
from radwrap.imaging.tolerance.uncertainty import Uncertainty, combined, spread_of, uncertainty_squares
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]


def relit_uncertainty(basis: Basis, factors: Array, image: Relit) -> Uncertainty:
    """How far a captured frame may be off a relit image: by the rays and by rounding at least.

    Parameters
    ----------
    basis : Basis
        Of the image.
    factors : ndarray, shape (sources,)
        Of the image.
    image : Relit
        The image.
    """
    return combined(relit_squares(basis, factors, image))


def relit_squares(basis: Basis, factors: Array, image: Relit) -> dict[str, Array]:
    """Square of what each cause adds at each pixel, see `uncertainty_squares`; arguments as `relit_uncertainty`."""
    tolerances = basis.tolerances
    spread = None
    if tolerances is not None and tolerances.each_source_radiance:
        spread = spread_of(
            factor * parts.mean(axis=0, dtype=np.float64)
            for factor, parts in zip(factors.tolist(), basis.images, strict=True)
        )
    magnification = None if basis.magnification is None else basis.magnification.astype(np.float64)
    return uncertainty_squares(
        image.radiant_exposure,
        basis.camera,
        tolerances or Tolerances(),
        image.certificate.rms_gray,
        spread,
        magnification=magnification,
    )
