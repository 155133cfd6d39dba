"""Standard deviation of each gray level of a relit image, by the tolerances that its basis tells.

As for a render, see `uncertainty`; but the sources' shares in a pixel are those
of the basis' own images, with all of the opening, not of the central ray alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.relight.relit import Basis, Relit
from radwrap.imaging.tolerance.uncertainty import Uncertainty, spread_of, uncertainty
from radwrap.scene.tolerances import Tolerances

Array = NDArray[np.float64]


def relit_uncertainty(basis: Basis, factors: Array, image: Relit) -> Uncertainty | None:
    """How far a captured frame may be off a relit image; None where nothing is known of it.

    Parameters
    ----------
    basis : Basis
        Of the image.
    factors : ndarray, shape (sources,)
        Of the image.
    image : Relit
        The image.
    """
    tolerances = basis.tolerances
    if tolerances is None and basis.sensor.linear is None:
        return None
    spread = None
    if tolerances is not None and tolerances.each_source_radiance:
        spread = spread_of(
            factor * parts.mean(axis=0, dtype=np.float64)
            for factor, parts in zip(factors.tolist(), basis.images, strict=True)
        )
    magnification = None if basis.magnification is None else basis.magnification.astype(np.float64)
    return uncertainty(
        image.radiant_exposure,
        basis.camera,
        tolerances or Tolerances(),
        image.certificate.rms_gray,
        spread,
        magnification=magnification,
    )
