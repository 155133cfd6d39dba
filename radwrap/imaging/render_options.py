"""How a scene is rendered."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, get_args

from radwrap.errors import InputError
from radwrap.imaging.asked_tolerance import COARSEST, FINEST, AskedTolerance, asked_tolerance
from radwrap.imaging.demand import Budget, Demand, SamplingPlan, ToleranceMethod
from radwrap.imaging.optics.aperture import LAYOUTS, Layout
from radwrap.imaging.optics.view import PixelSampling
from radwrap.imaging.option_values import choice_of, number_of, switch_of
from radwrap.process import MOST_WORKERS

FixedMethod = Literal["pinhole", "viewpoints"]
Method = Literal["pinhole", "viewpoints", "kernel", "rays", "hybrid"]
TracerName = Literal["auto", "radiance", "compiled"]
TRACERS: Final[tuple[TracerName, ...]] = get_args(TracerName)
METHODS: Final[tuple[Method, ...]] = ("pinhole", "viewpoints", "kernel", "rays", "hybrid")

_TO_TOLERANCE: Final[dict[Method | None, ToleranceMethod]] = {
    "kernel": "kernel",
    "rays": "rays",
    "hybrid": "hybrid",
}
_VIEWPOINTS: Final = 37

_PIXEL_SAMPLINGS: Final = get_args(PixelSampling)
# Least and largest of each number.
_WHOLE: Final = {
    "viewpoints": (1, 100_000),
    "pixel_samples": (1, 100),
    "seed": (0, 2**63 - 1),
    "workers": (1, MOST_WORKERS),
    "bounces": (0, 1000),
    "frames": (0, 10_000),
    "max_pixels": (1, 10**12),
}
_REAL: Final = {
    "tolerance": (FINEST, COARSEST),
    "max_error": (FINEST, COARSEST),
    "budget_rays": (1, 1e18),
    "budget_seconds": (1e-3, 1e9),
    "tracer_timeout": (1e-3, 1e9),
}
_NAMES: Final = {
    "method": METHODS,
    "layout": LAYOUTS,
    "pixel_sampling": _PIXEL_SAMPLINGS,
    "bounces": ("all", "auto"),
    "tracer": TRACERS,
}
_SWITCHES: Final = ("keep_viewpoints", "truth", "basis", "trust", "progress")


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """How a scene is rendered.

    Attributes
    ----------
    method : str, optional
        "pinhole" (infinitesimal), "viewpoints" (the paper's finite pinhole),
        "kernel", "rays", or "hybrid" (a kernel, and rays where it errs);
        default "viewpoints" where their number is given, or another option
        of theirs is, else the cheapest of the last three that keeps the
        tolerance.
    tolerance : float or str, optional
        Largest rms error of kernel, rays or hybrid: gray levels, or "0.2 %" of saturation minus dark, or "0.5 noise",
        of one frame's temporal noise, rms over the lit pixels. Default 0.5 gray levels; for a linear camera half of
        that noise, and at least 0.5/255 of full scale.
    max_error : float, optional
        Largest error of 99 % of the pixels, likewise [gray level].
    budget_rays, budget_seconds : float, optional
        What these may cost; by seconds [s] the same image may not
        come out again.
    viewpoints : int, optional
        Number of sub-viewpoints; default 37.
    layout : str
        How they lie, see `sub_viewpoints`.
    pixel_samples : int
        k; k x k rays a pixel for each sub-viewpoint.
    pixel_sampling : str
        "centre" of each stratum, or seeded "jitter".
    seed : int
        Seed of all that is drawn.
    workers : int, optional
        Tracer processes at a time; default one a core.
    keep_viewpoints : bool
        Keep the sub-viewpoints' files.
    truth : bool
        Write depth, parts and true positions too.
    bounces : int or str
        How often light may go from surface to surface: 0, a number, "all", or "auto", which is "all" where leaving it
        out would cost more than a small share of the tolerance, and 0 elsewhere.
    basis : bool
        Write one image for each source by the same rays too, from which `relit` makes any levels.
    sampling : SamplingPlan, optional
        By which kernel or rays sample, in place of their own search; the independent images are then kept too.
    frames : int
        Frames of a linear camera, with noise, to write too.
    trust : bool
        Let included Radiance files run commands and name any file.
    tracer : str
        "radiance"; "compiled", our own tracer, for scenes without mirrors, glass and Radiance files; or "auto", which
        is "compiled" where the scene has work enough for it, and it agrees with Radiance on a sample of rays.
    radiance : str, optional
        Folder of a Radiance other than the wheel's.
    max_pixels : int
        Largest sensor.
    tracer_timeout : float
        Longest silence of a tracer, and longest time of any other program [s].
    progress : bool
        Show progress on stderr.
    """

    method: Method | None = None
    tolerance: float | str | None = None
    max_error: float | None = None
    budget_rays: float | None = None
    budget_seconds: float | None = None
    viewpoints: int | None = None
    layout: Layout = "rings"
    pixel_samples: int = 1
    pixel_sampling: PixelSampling = "centre"
    seed: int = 0
    workers: int | None = None
    keep_viewpoints: bool = False
    truth: bool = False
    bounces: int | Literal["all", "auto"] = 0
    basis: bool = False
    sampling: SamplingPlan | None = None
    frames: int = 0
    trust: bool = False
    tracer: TracerName = "auto"
    radiance: str | None = None
    max_pixels: int = 64_000_000
    tracer_timeout: float = 600.0
    progress: bool = False

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None or field.default is not None:
                object.__setattr__(self, field.name, _checked(field.name, value))
        if self.viewpoints is not None and self.method not in {None, "viewpoints"}:
            raise InputError(
                f'there are no sub-viewpoints with `method="{self.method}"`', where="viewpoints", remedy="leave it out"
            )

        if self.fixed_method is not None:
            names = ("max_error", "budget_rays", "budget_seconds")
            for name in names:
                if getattr(self, name) is not None:
                    raise InputError(
                        f"{self.fixed_method} has a fixed number of rays and keeps no tolerance",
                        where=name,
                        remedy="leave it out, or leave out the method and its options",
                    )
        self._check_bounces()
        if self.basis and self.fixed_method is not None:
            raise InputError(
                f"needs an image to tolerance, not {self.fixed_method}",
                where="basis",
                remedy="leave out the method and its options, or name kernel, rays or hybrid",
            )

    def _check_bounces(self) -> None:
        if not self.bounces:
            return
        method = self.fixed_method or self.method
        if method not in {None, "rays"}:
            raise InputError(
                f"{method} has one ray at each place, which does not average walks of light: bounces need rays",
                where="bounces",
                remedy='leave out the method and its options, or give `method="rays"`',
            )
        if self.basis:
            raise InputError("does not go with bounces yet", where="basis", remedy="render each light by itself")

    @property
    def viewpoint_number(self) -> int:
        """Number of sub-viewpoints."""
        return _VIEWPOINTS if self.viewpoints is None else self.viewpoints

    @property
    def fixed_method(self) -> FixedMethod | None:
        """The method whose number of rays is fixed beforehand; None where a tolerance decides.

        An option that only the paper's method has asks for that method.
        """
        match self.method:
            case "pinhole" | "viewpoints":
                return self.method
            case "kernel" | "rays" | "hybrid":
                return None
        paper = self.viewpoints is not None or self.keep_viewpoints or self.pixel_samples != 1
        paper = paper or self.layout != "rings" or self.pixel_sampling != "centre"
        return "viewpoints" if paper else None

    @property
    def asked_tolerance(self) -> AskedTolerance:
        """The tolerance as it was asked for."""
        return asked_tolerance(self.tolerance)

    @property
    def gray_tolerance(self) -> float:
        """The tolerance, once it is known in gray levels, see `asked_tolerance`; ValueError before."""
        if isinstance(self.tolerance, str) or self.tolerance is None:
            raise ValueError("the tolerance is not known in gray levels yet")
        return self.tolerance

    @property
    def demand(self) -> Demand:
        """What kernel, rays or hybrid must keep, once the tolerance is known in gray levels."""
        budget = Budget(
            math.inf if self.budget_rays is None else self.budget_rays,
            math.inf if self.budget_seconds is None else self.budget_seconds,
        )
        return Demand(self.gray_tolerance, self.max_error, _TO_TOLERANCE.get(self.method), budget)


def _checked(name: str, value: Any) -> Any:
    """The value of an option, as JSON can hold it; those of other kinds are checked where they are used."""
    if name == "tolerance" and isinstance(value, str):
        return str(asked_tolerance(value))
    if name in _NAMES and not (name in _WHOLE and not isinstance(value, str)):
        return choice_of(value, name, _NAMES[name], otherwise=" or a whole number" if name in _WHOLE else "")
    if name in _WHOLE:
        return number_of(value, name, *_WHOLE[name], whole=True)
    if name in _REAL:
        return number_of(value, name, *_REAL[name], whole=False)
    return switch_of(value, name) if name in _SWITCHES else value
