"""Response of a sensor from frames of known exposure: G = K H^gamma + G0 up to saturation (Eqs. 5 to 7).

Two fits stand beside each other. Eq. 7, ln(G - G0) = gamma ln H + ln K, is the
paper's straight line; the direct fit of Eq. 5 in gray levels takes in the dim
and the dark frames too, and frees G0. K has the unit of gray times exposure to
the power of -gamma.

Rules, all on the gray level that the fit predicts, never on the measured one,
which would pick frames by their noise. Saturated: it lies `NEAR_SATURATION` of
the range (at least `NOISE_MARGIN` sigma of a frame, at least half a step of
rounding) beyond saturation. Near saturation: within as much below or above, left out
of both fits, because noise is clipped there. Dark: less than `ABOVE_DARK` sigma
above G0, left out of Eq. 7, because there the logarithm is skewed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from radwrap.calibrate.response_fits import (
    GAMMA_LIMITS,
    Array,
    Flags,
    Groups,
    NoiseSource,
    PowerFit,
    Selection,
    Variance,
    fit_gray,
    fit_logarithms,
    no_plateau,
    rounding_variance,
)
from radwrap.errors import InputError

NEAR_SATURATION: Final = 0.02  # of saturation - dark: pixels of one frame differ by about as much
NOISE_MARGIN: Final = 3.0  # sigma of one frame: clipping then moves the mean by 4e-4 sigma at most
ABOVE_DARK: Final = 5.0  # sigma of G - G0: ln is off by sigma^2/2 = 0.1 of its own standard error
FEWEST_EXPOSURES: Final = 3  # two unknowns of Eq. 7, and one more for a residual
ROUNDS: Final = 50  # of fit and rule; three to five is usual
_SETTLED: Final = 1e-13  # relative change of gamma at which nothing moves any more

PARAMETERS: Final = ("ln_K", "gamma", "dark_gray", "saturation_gray")


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A frame that a fit did not use: its number (from 0), which fits ("eq7", "direct"), and why."""

    frame: int
    fits: tuple[str, ...]
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """What a sensor makes of radiant exposure.

    Attributes
    ----------
    eq7, direct : PowerFit
        The straight line in logarithms, and the fit in gray levels.
    saturation_gray : float
        Highest gray level.
    covariance : ndarray, shape (4, 4)
        Of `PARAMETERS`, from the direct fit.
    residuals : ndarray, shape (n,)
        Measured less predicted gray level (direct fit, saturation applied), a frame each.
    left_out : tuple of LeftOut
        Frames that a fit did not use.
    noise_source : str
        Where the variances come from: "given", "repeats" of one exposure, or the "residuals" of the fit.
    noise_gray : float
        Standard deviation of one frame, mean over the frames in the direct fit [gray].
    misfit_probability : float or None
        Chance of so large a chi_square if Eq. 5 holds; None where the residuals themselves set the variances.
    exposure_unit : str
        "J/m^2", or "J" with the paper's literal Eq. 6.
    """

    eq7: PowerFit
    direct: PowerFit
    saturation_gray: float
    covariance: Array
    residuals: Array
    left_out: tuple[LeftOut, ...]
    noise_source: NoiseSource
    noise_gray: float
    misfit_probability: float | None
    exposure_unit: str

    @property
    def gain(self) -> float:
        """K of the direct fit."""
        return self.direct.gain

    @property
    def gamma(self) -> float:
        """Exponent of the direct fit."""
        return self.direct.gamma

    @property
    def dark_gray(self) -> float:
        """G0 of the direct fit."""
        return self.direct.dark_gray

    @property
    def gain_unit(self) -> str:
        """Unit of K, such as gray (J/m^2)^-0.85."""
        unit = f"({self.exposure_unit})" if "/" in self.exposure_unit else self.exposure_unit
        return f"gray {unit}^-{self.gamma:.4g}"

    @property
    def scene_gain(self) -> str | None:
        """K as a scene file takes it, all digits; None where exposure is no energy per area."""
        return f"{self.gain!r} (J/m^2)^-{self.gamma!r}" if self.exposure_unit == "J/m^2" else None

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard errors of K, gamma, dark_gray and saturation_gray; 0 for what was given."""
        return {**self.direct.sigma, "saturation_gray": float(math.sqrt(self.covariance[3, 3]))}

    def gain_sigma_with_source(self, relative: float) -> float:
        """Standard error of K for a source known to `relative` (1 sigma): K goes with P_s^-gamma, gamma does not."""
        return self.gain * math.hypot(math.sqrt(self.covariance[0, 0]), self.gamma * relative)

    @property
    def residual_rms_gray(self) -> float:
        """Root mean square of the direct fit's residuals over the frames that it used."""
        return float(np.sqrt(np.mean(self.residuals[list(self.direct.frames)] ** 2)))


def exposure_at_distance(exposure_time: Array, radiant_intensity: float, distance: float) -> Array:
    """H = tau P_s / D^2 [J m^-2]: Eq. 6 read as energy per area (ERRATA); tau [s], P_s [W/sr], D [m]."""
    return np.asarray(exposure_time * (radiant_intensity / distance**2))


def energy_in_cone(
    exposure_time: Array,
    radiant_intensity: float,
    cone_angle: float,
    solid_angle: Literal["exact", "paper"] = "paper",
) -> Array:
    """E = tau P_s times the cone's solid angle [J]: Eq. 6 as printed.

    Parameters
    ----------
    exposure_time : ndarray
        tau [s].
    radiant_intensity : float
        P_s [W/sr].
    cone_angle : float
        Full angle epsilon [rad].
    solid_angle : str
        "paper": pi tan^2(epsilon/2); "exact": 2 pi (1 - cos(epsilon/2)), 0.28 % less at 7 degrees.
    """
    half = cone_angle / 2
    # 2 pi (1 - cos x) = 4 pi sin^2(x/2), which keeps its digits at small angles.
    size = math.pi * math.tan(half) ** 2 if solid_angle == "paper" else 4 * math.pi * math.sin(half / 2) ** 2
    return np.asarray(exposure_time * (radiant_intensity * size))


def fit_response(
    radiant_exposure: Array,
    gray: Array,
    *,
    dark: float | None = None,
    saturation: float | None = None,
    quantisation: float = 1.0,
    noise: float | None = None,
    gamma: float | None = None,
    start_gamma: float | None = None,
    exposure_unit: str = "J/m^2",
) -> Response:
    """Find K, gamma, G0 and saturation of Eq. 5 from frames of known exposure.

    Parameters
    ----------
    radiant_exposure : ndarray, shape (n,)
        H of each frame [exposure_unit]; 0 for a dark frame. Frames of equal exposure are repeats.
    gray : ndarray, shape (n,)
        Gray level of each frame, of one pixel or the mean of many.
    dark : float, optional
        G0; default from the dark frames.
    saturation : float, optional
        Highest gray level; default from the plateau at large exposures.
    quantisation : float
        Step of the gray levels, whose rounding has the variance step^2/12; 0 if they are not rounded.
    noise : float, optional
        Standard deviation of a frame without rounding [gray]; default from repeats, else from the residuals.
    gamma : float, optional
        Exponent where it is known, such as 1 of a linear camera; default fitted.
    start_gamma : float, optional
        Where the direct fit starts; default from Eq. 7. For each gamma the best K and G0 are known at once.
    exposure_unit : str
        Unit of the exposures, for K's unit.

    Returns
    -------
    Response
        Both fits, what they used and what they left out.

    Raises
    ------
    InputError
        If the numbers are no frames, dark or saturation cannot be had from
        them, or fewer than three exposures lie between the two.

    Examples
    --------
    >>> import numpy as np, radwrap
    >>> exposure = np.linspace(0, 2e-3, 40)
    >>> gray = np.rint(22 + 3.38e4 * exposure**0.85)
    >>> found = radwrap.fit_response(exposure, gray, saturation=255)
    >>> bool(abs(found.direct.gamma - 0.85) < 0.02)
    True
    """
    exposure, gray = np.asarray(radiant_exposure, np.float64), np.asarray(gray, np.float64)
    _check(exposure, gray, [quantisation, *(value for value in (noise, dark, saturation) if value is not None)])
    if gamma is not None and not GAMMA_LIMITS[0] <= gamma <= GAMMA_LIMITS[1]:
        raise InputError(f"gamma must lie between {GAMMA_LIMITS[0]:g} and {GAMMA_LIMITS[1]:g}, not {gamma:g}")
    groups = Groups(exposure, gray, quantisation)
    if dark is None and not groups.is_dark.any():
        raise InputError(
            "no frame has the exposure 0, so the dark gray level is unknown", remedy="add one, or give `dark`"
        )
    first_dark = dark if dark is not None else float(groups.mean[groups.is_dark][0])
    if saturation is None:
        level, plateau = groups.plateau()
    else:
        level, plateau = saturation, groups.mean >= saturation
        if groups.mean.max() > saturation + NEAR_SATURATION * abs(saturation - first_dark) + 5 * quantisation:
            raise InputError(f"frames of gray level {groups.mean.max():g} are above the saturation of {saturation:g}")
    if level <= first_dark:
        raise InputError(f"saturation ({level:g}) is not above dark ({first_dark:g})", remedy="is there any light?")
    variance = groups.noise_model(noise, first_dark, ~plateau)
    task = _Task(groups, variance, first_dark, dark is None, saturation is None, gamma, start_gamma, exposure_unit)
    return _settle(task, level)


def _check(exposure: Array, gray: Array, not_negative: list[float]) -> None:
    if exposure.ndim != 1 or exposure.shape != gray.shape or exposure.size == 0:
        raise InputError(f"needs as many exposures as gray levels, not {exposure.shape} and {gray.shape}")
    if not (np.isfinite(exposure).all() and np.isfinite(gray).all()):
        raise InputError("an exposure or gray level is not a finite number")
    if not np.isfinite(not_negative).all():
        raise InputError("dark, saturation, noise and quantisation must be finite numbers")
    if (exposure < 0).any():
        raise InputError(f"frame {int(np.argmin(exposure)) + 1} has a negative exposure")
    if min(not_negative) < 0:
        raise InputError("dark, saturation, noise and quantisation must not be negative")


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What a fit is made of: frames, their variances, what is known and what is free."""

    groups: Groups
    variance: Variance
    dark: float
    free_dark: bool
    free_saturation: bool
    gamma: float | None
    start_gamma: float | None
    exposure_unit: str

    def margin(self, level: float) -> float:
        """Distance from saturation within which a frame is neither below it nor beyond it."""
        noise = float(np.sqrt(self.variance.of(np.array([level]))[0]))
        return max(NEAR_SATURATION * (level - self.dark), NOISE_MARGIN * noise, self.groups.step / 2)


def _settle(task: _Task, level: float) -> Response:
    """Fit, apply the rules to what the fit predicts, and again, until nothing moves."""
    groups, dark = task.groups, task.dark
    predicted = np.where(groups.mean >= level - task.margin(level), np.inf, groups.mean)
    predicted[groups.is_dark] = dark
    gamma = math.nan
    for _ in range(ROUNDS):
        margin = task.margin(level)
        unsaturated, on_plateau = predicted < level - margin, predicted > level + margin
        if task.free_saturation:
            if not on_plateau.any():
                raise no_plateau()
            level = float(np.average(groups.mean[on_plateau], weights=groups.count[on_plateau]))
        clipped = np.minimum(predicted, level)
        spread = groups.mean_variance(task.variance, clipped)
        dark_variance = float(spread[groups.is_dark][0]) if task.free_dark else 0.0
        above = clipped - dark > ABOVE_DARK * np.sqrt(spread + dark_variance)
        lit = unsaturated & above & (groups.mean > dark) & ~groups.is_dark
        if lit.sum() < FEWEST_EXPOSURES:
            raise InputError(
                f"{lit.sum()} exposures lie clear of dark ({dark:.4g}) and saturation ({level:.4g}); "
                f"at least {FEWEST_EXPOSURES} are needed",
                remedy="add frames between the two",
            )
        line = Selection(groups, lit, spread, task.variance)
        eq7 = fit_logarithms(line, clipped, dark, dark_variance, task.gamma)
        used = Selection(groups, unsaturated & (task.free_dark | ~groups.is_dark), spread, task.variance)
        first = task.gamma or task.start_gamma or eq7.gamma
        direct = fit_gray(used, first, dark, free_dark=task.free_dark, free_gamma=task.gamma is None)
        predicted = direct.gray(groups.exposure)
        same = ((predicted < level - margin) == unsaturated).all()
        if same and abs(direct.gamma / gamma - 1) < _SETTLED:
            break
        gamma = direct.gamma
    level_variance = _level_variance(task, on_plateau) if task.free_saturation else 0.0
    return _response(task, eq7, direct, (level, level_variance), (unsaturated, on_plateau))


def _level_variance(task: _Task, on_plateau: Flags) -> float:
    """Variance of the plateau's level: noise of its own frames, and rounding, which all of them share."""
    groups = task.groups
    values = groups.frame_gray[on_plateau[groups.of_frame]]
    own = float(values.var(ddof=1)) if len(values) > 1 else task.variance.offset
    return own / len(values) + float(rounding_variance(np.array([own]), groups.step)[0])


def _response(
    task: _Task, eq7: PowerFit, direct: PowerFit, saturation: tuple[float, float], rules: tuple[Flags, Flags]
) -> Response:
    groups, variance = task.groups, task.variance
    level, level_variance = saturation
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = direct.covariance
    covariance[3, 3] = level_variance
    residuals = groups.frame_gray - np.minimum(direct.gray(groups.frame_exposure), level)
    known = variance.source != "residuals"
    probability = None
    if known:
        from scipy.stats import chi2

        probability = float(chi2.sf(direct.chi_square, direct.degrees_of_freedom))
    used = list(direct.frames)
    frame = np.sqrt(variance.of(direct.gray(groups.frame_exposure[used]))) if known else residuals[used]
    return Response(
        eq7=eq7,
        direct=direct,
        saturation_gray=level,
        covariance=covariance,
        residuals=residuals,
        left_out=tuple(_left_out(groups, eq7, direct, level, rules)),
        noise_source=variance.source,
        noise_gray=float(np.sqrt(np.mean(frame**2))),
        misfit_probability=probability,
        exposure_unit=task.exposure_unit,
    )


def _left_out(
    groups: Groups, eq7: PowerFit, direct: PowerFit, level: float, rules: tuple[Flags, Flags]
) -> Iterator[LeftOut]:
    unsaturated, on_plateau = rules
    predicted = direct.gray(groups.exposure)
    in_eq7, in_direct = set(eq7.frames), set(direct.frames)
    for frame, group in enumerate(groups.of_frame):
        fits = tuple(name for name, used in (("eq7", in_eq7), ("direct", in_direct)) if frame not in used)
        if on_plateau[group]:
            reason = f"saturated: {predicted[group]:.4g} by the power law, saturation is {level:.4g}"
        elif not unsaturated[group]:
            reason = f"near saturation: {predicted[group]:.4g} by the power law, saturation is {level:.4g}"
        elif groups.is_dark[group]:
            reason = "no exposure: it has no logarithm, and gives the dark gray level"
        else:
            reason = (
                f"dark: {predicted[group]:.4g} is less than {ABOVE_DARK:g} sigma above dark, {direct.dark_gray:.4g}"
            )
        if fits:
            yield LeftOut(frame, fits, reason)
