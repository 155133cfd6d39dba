"""What a trade compares and what it finds: settings, their rows, and the files in which these wait for the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.imaging.demand import ToleranceMethod
from radwrap.imaging.optics.aperture import Layout
from radwrap.imaging.optics.view import PixelSampling
from radwrap.imaging.render_options import RenderOptions
from radwrap.manifest import json_text
from radwrap.process import available_cores
from radwrap.reading import read_json
from radwrap.study.reference import Distance, Reference, check_reference

Family = Literal["pinhole", "viewpoints", "kernel", "hybrid", "rays"]

CERTIFIED: Final[tuple[ToleranceMethod, ...]] = ("kernel", "hybrid", "rays")
_LONGEST_LIMITS: Final = (1e-3, 1e9)


@dataclass(frozen=True, slots=True)
class Setting:
    """A method with its options.

    Attributes
    ----------
    method : str
        "pinhole", "viewpoints", "kernel", "hybrid" or "rays".
    viewpoints : int, optional
        Number of sub-viewpoints.
    layout : str, optional
        How they lie.
    pixel_samples : int
        k; k x k rays a pixel and sub-viewpoint.
    pixel_sampling : str
        "centre" or "jitter".
    tolerance : float, optional
        Asked of kernel, hybrid or rays [gray level rms].
    """

    method: Family
    viewpoints: int | None = None
    layout: Layout | None = None
    pixel_samples: int = 1
    pixel_sampling: PixelSampling = "centre"
    tolerance: float | None = None

    @property
    def options(self) -> str:
        """The same as options of ``radwrap render``."""
        words = [f"--method {self.method}"]
        if self.tolerance is not None:
            return f"{words[0]} --tolerance {self.tolerance:g}"
        if self.viewpoints is not None:
            words.append(f"--viewpoints {self.viewpoints} --layout {self.layout}")
        if self.pixel_samples != 1:
            words.append(f"--pixel-samples {self.pixel_samples}")
        if self.pixel_sampling != "centre":
            words.append(f"--pixel-sampling {self.pixel_sampling}")
        return " ".join(words)

    @property
    def name(self) -> str:
        """The options as a file name."""
        words = self.options.removeprefix("--method ").replace("viewpoints --viewpoints", "viewpoints")
        return words.replace(" --", "_").replace(" ", "-")


@dataclass(frozen=True, slots=True)
class Row:
    """What a setting cost, and how good it was.

    Attributes
    ----------
    setting : Setting
        What was done.
    rays : int
        Rays in all.
    met : bool or None
        Whether kernel, hybrid or rays certified their tolerance.
    certified_rms_gray_upper95 : float or None
        What they certified [gray level].
    error : Distance
        From the reference [gray level].
    wall_s, cpu_s : float
        Wall time, and CPU time of this process and its tracers [s].
    """

    setting: Setting
    rays: int
    met: bool | None
    certified_rms_gray_upper95: float | None
    error: Distance
    wall_s: float
    cpu_s: float


class TooLong(Exception):
    """A setting is expected to take longer than it may."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A setting that was not run, and why."""

    setting: Setting
    why: str


@dataclass(frozen=True, slots=True)
class TradeOptions:
    """How methods are compared.

    Attributes
    ----------
    longest : float
        A setting that is expected to take longer is left out [s].
    reference_pixels, reference_rays : int
        Pixels of the reference, and rays of each of its two values.
    render : RenderOptions
        Seed, workers, tracer, and the tolerance that is wanted; its method is not used.
    """

    longest: float = 60.0
    reference_pixels: int = 2000
    reference_rays: int = 1024
    render: RenderOptions = field(default_factory=RenderOptions)

    def __post_init__(self) -> None:
        low, high = _LONGEST_LIMITS
        if not low <= self.longest <= high:
            raise InputError(f"must lie between {low:g} and {high:g} s, not {self.longest:g}", where="longest")
        check_reference(self.reference_pixels, self.reference_rays)

    @property
    def workers(self) -> int:
        """Tracer processes at a time."""
        return self.render.workers or available_cores()


@dataclass(frozen=True, slots=True, eq=False)
class Trade:
    """All that was measured on a scene.

    Attributes
    ----------
    title : str
        Where the scene comes from.
    run_sha256 : str
        Of all that decides the numbers.
    options : TradeOptions
        How.
    tolerance : float
        What is wanted [gray level rms].
    reference : Reference
        What errors are taken against.
    rows : tuple of Row
        In the order of the sweep.
    left_out : tuple of LeftOut
        What was not run.
    """

    title: str
    run_sha256: str
    options: TradeOptions
    tolerance: float
    reference: Reference
    rows: tuple[Row, ...]
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True, slots=True)
class RowFiles:
    """Files of what is finished, each of which knows the run that it is of.

    Attributes
    ----------
    folder : Path
        Where they lie.
    run_sha256 : str
        Of all that decides their numbers.
    """

    folder: Path
    run_sha256: str

    def read(self, name: str) -> dict[str, Any] | None:
        """What an equal run left under a name; None where there is nothing of it."""
        try:
            found = read_json(self.folder / f"{name}.json")
            content: dict[str, Any] | None = found["content"] if found["run_sha256"] == self.run_sha256 else None
        except (InputError, KeyError, TypeError):
            return None
        return content

    def write(self, name: str, content: dict[str, Any]) -> None:
        """Leave something under a name."""
        told = {"run_sha256": self.run_sha256, "content": content}
        write_bytes(self.folder / f"{name}.json", json_text(told).encode())


def row_from_json(found: dict[str, Any]) -> Row:
    """A row that was written by `dataclasses.asdict`."""
    return Row(**{**found, "setting": Setting(**found["setting"]), "error": Distance(**found["error"])})
