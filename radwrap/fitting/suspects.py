"""What is left of captures that a scene does not explain looks like this or that which a camera or its light may do.

Each suspect is an image: by how much gray levels would change if it were so. What the free keys do as well is taken
away from it. The one that explains most of what is left is named, then what explains most of the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.fitting.covariance import PredictionErrors
from radwrap.fitting.prediction import Part

Array = NDArray[np.float64]
_LEVEL: Final = 0.01  # that any is named by chance
_SHARE: Final = 0.1  # of what is left beyond its expectation: a suspect that explains less is not named
_MOST: Final = 3
_ALIKE: Final = 0.9  # of what the best one explains: who explains more is named beside it
_OWN: Final = 1e-2  # of a suspect's image, by its length: what the free keys leave of it


@dataclass(frozen=True, slots=True)
class Suspect:
    """Something that the scene does not state, and that captures look like.

    Attributes
    ----------
    name : str
        "falloff", "distortion", "size", "shift along u", "shift along v", "blur", "light along u", "light along v",
        "brightness" or "offset".
    amount : float
        How much of it.
    unit : str
        In which.
    lowers : float
        By how much the sum of squares would be lower.
    alike : tuple of str
        In words, what would explain nearly as much.
    """

    name: str
    amount: float
    unit: str
    lowers: float
    alike: tuple[str, ...] = ()

    def told(self) -> str:
        """In words."""
        others = "".join(f", or {words}" for words in self.alike)
        return f"{_WORDS[self.name](self.amount)}{others} (chi-square would be lower by {self.lowers:.3g})"


def _more(amount: float) -> str:
    return "more" if amount > 0 else "less"


def _side(percent: float) -> str:
    return f"{abs(percent):.2g} % {'brighter' if percent > 0 else 'darker'}"


_WORDS: Final[dict[str, Callable[[float], str]]] = {
    "falloff": lambda a: f"light falls off towards the corners by {abs(a):.2g} % {_more(a)} than the scene says",
    "distortion": lambda a: (
        f"distortion moves the corners {abs(a):.2g} px {'out' if a > 0 else 'in'}wards, which the scene does not say"
    ),
    "size": lambda a: f"the image is {'larger' if a > 0 else 'smaller'}, by {abs(a):.2g} px at the corners",
    "shift along u": lambda a: f"the image lies {abs(a):.2g} px farther to the {'right' if a > 0 else 'left'}",
    "shift along v": lambda a: f"the image lies {abs(a):.2g} px farther {'down' if a > 0 else 'up'}",
    "blur": lambda a: f"the image is {'more' if a > 0 else 'less'} blurred, sigma^2 by {abs(a):.2g} px^2",
    "light along u": lambda a: f"the right side is {_side(a)}, and the left side the other way",
    "light along v": lambda a: f"the bottom is {_side(a)}, and the top the other way",
    "brightness": lambda a: f"all is {_side(a)}",
    "offset": lambda a: f"all is {abs(a):.2g} gray levels {'brighter' if a > 0 else 'darker'}",
}
_UNITS: Final = {"falloff": "%", "light along u": "%", "light along v": "%", "brightness": "%", "blur": "px^2"}


def changes_of(part: Part) -> dict[str, Array]:
    """What gray levels change by for one unit of each suspect, of one capture.

    Parameters
    ----------
    part : Part
        What is predicted.

    Returns
    -------
    dict of str to ndarray, shape (rows, columns)
        [gray level] for a percent, a pixel or a gray level.
    """
    gray = part.unclipped
    rows, columns = gray.shape
    v, u = np.mgrid[0:rows, 0:columns] - np.array([(rows - 1) / 2, (columns - 1) / 2])[:, np.newaxis, np.newaxis]
    corner = float(np.hypot(rows, columns)) / 2
    # G - dark grows as H^gamma: a percent of light is gamma percent of it.
    percent = part.sensor.gamma * (gray - part.sensor.dark_gray) / 100
    down, right = _steep(gray, 0), _steep(gray, 1)
    outwards = -(right * u + down * v) / corner
    share = (u**2 + v**2) / corner**2
    lens = part.scene.camera.lens
    # Light is conserved: what is spread over 4 a r^2 more area is dimmer by that share. A falloff that is given on the
    # sensor holds that already.
    dimmer = 4 / corner * 100 * percent if lens is None or lens.relative_illumination is None else 0.0
    return {
        "falloff": -percent * share,
        "distortion": (outwards - dimmer) * share,
        "size": outwards,
        "shift along u": -right,
        "shift along v": -down,
        "blur": (_steep(down, 0) + _steep(right, 1)) / 2,
        "light along u": percent * u / (columns / 2),
        "light along v": percent * v / (rows / 2),
        "brightness": percent,
        "offset": np.ones_like(gray),
    }


def _steep(image: Array, axis: int) -> Array:
    """Change from pixel to pixel; none along a single row or column."""
    return np.asarray(np.gradient(image, axis=axis)) if image.shape[axis] > 1 else np.zeros_like(image)


def suspects(
    parts: Sequence[Part], residual: Array, sigma: Array, basis: Array, errors: PredictionErrors
) -> tuple[Suspect, ...]:
    """Name what the residual looks like, what explains most of it first.

    Parameters
    ----------
    parts : sequence of Part
        What is predicted for each capture.
    residual : ndarray, shape (captures * rows, columns)
        (captured - predicted)/sigma; NaN where a pixel was not used.
    sigma : ndarray, shape (captures * rows, columns)
        Expected deviation [gray level].
    basis : ndarray, shape (pixels, n)
        Orthonormal, of all changes of the used pixels that the free keys make, over sigma.
    errors : PredictionErrors
        Of the used pixels.

    Returns
    -------
    tuple of Suspect
        Each significant at the 1 % level for all of them together; none where nothing of the kind is left.
    """
    from scipy.stats import chi2

    used = np.isfinite(residual)
    left, weight = residual[used], sigma[used]
    changes = [changes_of(part) for part in parts]
    images = {name: np.concatenate([one[name] for one in changes])[used] / weight for name in changes[0]}
    images = _showing(images, basis)
    limit = float(chi2(1).ppf(1 - _LEVEL / max(len(images), 1)))
    off = errors.deviations / np.sqrt(errors.freedom * errors.predictions)
    left = _beside(left, basis)
    named: list[Suspect] = []
    while images and len(named) < _MOST:
        best, best_own, lowers = "", left, 0.0
        gains: dict[str, tuple[float, float]] = {}
        for name, image in images.items():
            own = _beside(image, basis)
            own = own / float(np.linalg.norm(own))
            # The prediction's own error may look like it too.
            may = 1.0 + float(((off @ own) ** 2).sum()) + float(np.abs(own) @ errors.bound) ** 2
            gain = float(own @ left) ** 2
            gains[name] = gain, float(own @ left) / float(own @ image)
            if gain / may > limit and gain > lowers:
                best, best_own, lowers = name, own, gain
        excess = float(left @ left) - (left.size - basis.shape[1])
        if not best or lowers < _SHARE * excess:
            break
        close = [name for name, (gain, _) in gains.items() if name != best and gain > _ALIKE * lowers]
        alike = tuple(_WORDS[name](gains[name][1]) for name in close)
        amount = float(best_own @ left) / float(best_own @ images[best])
        named.append(Suspect(best, amount, _UNITS.get(best, "px" if best != "offset" else "gray"), lowers, alike))
        left = left - best_own * float(best_own @ left)
        basis = np.concatenate([basis, best_own[:, np.newaxis]], axis=1)
        del images[best]
        images = _showing(images, basis)
    return tuple(named)


def _showing(images: dict[str, Array], basis: Array) -> dict[str, Array]:
    """Those of which something is left beside an orthonormal basis."""
    return {
        name: image
        for name, image in images.items()
        if float(np.linalg.norm(_beside(image, basis))) > _OWN * float(np.linalg.norm(image))
    }


def _beside(image: Array, basis: Array) -> Array:
    """What of an image an orthonormal basis does not hold."""
    return np.asarray(image - basis @ (basis.T @ image))
