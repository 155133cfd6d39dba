"""How far the gauges' numbers may be trusted: random pictures of known geometry, by gauge and by blur.

Usage: gauges.py [--scenes 200] [--frames 20] [--seed 2] [--gauges circle width ...] [--blurs 0 1 2] [--json FILE]

Each scene is drawn with its blur (.3 to 1, 1 to 2, 2 to 5 px), size, place, levels and noise; a quarter of them each
has uneven light, a neighbour that touches, or a half-tone rim narrower than the blur. z is the error over the standard
error of noise, frame by frame; bias is that of a scene's mean, and of the picture without noise. What fails is counted,
and so are stripes that have a middle and no width, whose place and direction have a z of their own. OpenCV's usual ways
see the same frames. What gauges say of things of another shape or blur is counted by `wrong_models.py`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.images import GrayImage
from radwrap.measure.gauges import Caliper, StraightCaliper, measure_circle, measure_line, measure_width

Array = NDArray[np.float64]

BLURS: Final = ((0.3, 1.0), (1.0, 2.0), (2.0, 5.0))
SIDE: Final = 128  # px, at most
FINE: Final = 8  # places a side in each pixel
GAUGES: Final = ("circle", "width", "line", "stripe")


@dataclass
class Tally:
    """What came of a gauge in a class of blur."""

    z: list[float] = field(default_factory=list)
    bias: list[float] = field(default_factory=list)
    exact: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)
    failed: int = 0
    warned: int = 0
    frames: int = 0
    without_width: int = 0
    by_middle: dict[str, list[float]] = field(default_factory=dict)
    others: dict[str, list[float]] = field(default_factory=dict)

    def told(self) -> dict[str, Any]:
        """Numbers to report."""
        if not self.z:
            return {"frames": self.frames, "failed": self.failed}
        z, bias, sigma, exact = map(np.array, (self.z, self.bias, self.sigma, self.exact))
        seen = exact[np.isfinite(exact)]
        small = np.abs(exact) < np.maximum(0.1 * sigma, 0.01)
        return {
            "frames": self.frames,
            "failed": self.failed,
            "warned": self.warned,
            "without_width": self.without_width,
            "by_middle": {
                name: {"z_mean": float(np.mean(z)), "z_sd": float(np.std(z)), "z_largest": float(np.abs(z).max())}
                for name, z in self.by_middle.items()
            },
            "z_mean": float(z.mean()),
            "z_sd": float(z.std()),
            "z_largest": float(np.abs(z).max()),
            "bias_median": float(np.median(bias)),
            "bias_rms": float(np.sqrt(np.mean(bias**2))),
            "bias_without_noise_rms": float(np.sqrt(np.mean(seen**2))) if seen.size else math.nan,
            "refused_without_noise": int(np.isnan(exact).sum()),  # their bias counts as large
            "sigma_median": float(np.median(sigma)),
            "scenes_of_small_bias": float(small.mean()),
            "others_rms": {name: float(np.sqrt(np.nanmean(np.square(v)))) for name, v in self.others.items()},
            "others_median": {name: float(np.nanmedian(v)) for name, v in self.others.items()},
        }


@dataclass(frozen=True)
class Said:
    """What a gauge says of a frame; a stripe's width may be None, and z are those of its place and direction."""

    value: float | None
    sigma: float
    warned: bool
    by_middle: tuple[float, ...] = ()


@dataclass(frozen=True)
class Picture:
    """Light without noise, and what a gauge does with a frame of it."""

    light: Array
    true: float
    measured: Callable[[GrayImage], Said]
    radius: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)


def places(side: int) -> tuple[Array, Array]:
    """Columns and rows of all fine places of a picture."""
    at = (np.arange(side * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(at, at)
    return u, v


def blurred(sharp: Array, blur: float) -> Array:
    """Pixels of fine light, blurred by a disc."""
    from scipy.signal import oaconvolve

    half = math.ceil(blur * FINE) + 1
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    disc = np.clip(blur * FINE + 0.5 - np.hypot(x, y), 0, 1)
    padded = np.pad(sharp, half, mode="edge")
    smooth = oaconvolve(padded, disc / disc.sum(), mode="valid")
    side = sharp.shape[0] // FINE
    return np.asarray(smooth.reshape(side, FINE, side, FINE).mean(axis=(1, 3)))


def soft(distance: Array) -> Array:
    """Share of a fine place on the side where the distance is above 0: fine places are squares of 1/FINE px."""
    return np.clip(distance * FINE + 0.5, 0.0, 1.0)


def picture(kind: str, dice: np.random.Generator, blur: float) -> Picture:
    """A random scene for a gauge."""
    low = dice.uniform(15, 60)
    high = low + dice.uniform(50, 180)
    if dice.random() < 0.5:
        low, high = high, low
    make = _circle if kind == "circle" else _straight
    return make(kind, dice, blur, (low, high))


def _finished(dice: np.random.Generator, sharp: Array, uv: tuple[Array, Array], blur: float) -> Array:
    """Uneven light in a quarter of the scenes, and blur."""
    if dice.random() < 0.25:
        side = sharp.shape[0] / FINE
        slopes = dice.uniform(-0.3, 0.3, 2)
        sharp = sharp * (1 + slopes[0] * (uv[0] / side - 0.5) + slopes[1] * (uv[1] / side - 0.5))
    return np.clip(blurred(sharp, blur), 0, 250)


def _circle(_: str, dice: np.random.Generator, blur: float, levels: tuple[float, float]) -> Picture:
    radius = dice.uniform(max(8.0, 2.5 * blur + 2), 42.0)
    side = min(SIDE, int(2 * radius + 2 * blur + 34))
    centre = side / 2 + dice.uniform(-2, 2, 2)
    u, v = places(side)
    inside = soft(radius - np.hypot(u - centre[0], v - centre[1]))
    if dice.random() < 0.25:
        turn, size = dice.uniform(0, 2 * math.pi), dice.uniform(0.15, 0.3) * radius + 2
        other = centre + (radius + size - 0.5) * np.array([math.cos(turn), math.sin(turn)])
        inside = np.maximum(inside, soft(size - np.hypot(u - other[0], v - other[1])))
    light = _finished(dice, levels[0] + (levels[1] - levels[0]) * inside, (u, v), blur)
    off, about = dice.uniform(-1, 1, 2), radius + dice.uniform(-1.5, 1.5)
    caliper = Caliper((float(centre[0] + off[0]), float(centre[1] + off[1])), about, min(8.0, radius - 1.5))

    def measured(image: GrayImage) -> Said:
        found = measure_circle(image, caliper)
        return Said(found.diameter, found.diameter_sigma, bool(found.warnings))

    return Picture(light, 2 * radius, measured, radius, (float(centre[0]), float(centre[1])))


def _straight(kind: str, dice: np.random.Generator, blur: float, levels: tuple[float, float]) -> Picture:
    side = 96
    angle, centre = dice.uniform(-math.pi, math.pi), side / 2 + dice.uniform(-3, 3, 2)
    size = {"line": 0.0, "stripe": dice.uniform(1.2 * blur + 2, 3 * blur + 8)}.get(
        kind, dice.uniform(2 * blur + 10, 40.0)
    )
    u, v = places(side)
    across = (u - centre[0]) * math.cos(angle) + (v - centre[1]) * math.sin(angle)
    inside = soft(across) if kind == "line" else soft(size / 2 - np.abs(across))
    light = _finished(dice, levels[0] + (levels[1] - levels[0]) * inside, (u, v), blur)
    off = dice.uniform(-1, 1, 2)
    caliper = StraightCaliper(
        (float(centre[0] + off[0]), float(centre[1] + off[1])),
        angle + dice.uniform(-0.05, 0.05),
        36.0,
        10.0 if kind == "line" else size / 2 + 8 + blur,
    )

    def measured(image: GrayImage) -> Said:
        if kind == "width":
            width = measure_width(image, caliper)
            return Said(width.width, width.width_sigma or math.nan, bool(width.warnings))
        line = measure_line(image, caliper, stripe=kind == "stripe")
        (a, b), (c, d) = line.centre, centre
        across = (a - c) * math.cos(angle) + (b - d) * math.sin(angle)
        if kind == "line":
            return Said(across, line.position_sigma, bool(line.warnings))
        turn = (line.angle - angle + math.pi / 2) % math.pi - math.pi / 2
        by_middle = across / line.position_sigma, turn / line.angle_sigma
        # That a width is not known is counted by itself.
        warned = len(line.warnings) > bool(line.readings)
        return Said(line.width, line.width_sigma or math.nan, warned, by_middle)

    return Picture(light, size, measured)


def frame(light: Array, dice: np.random.Generator, gain: float, read: float) -> GrayImage:
    """Whole gray levels of shot noise and read noise."""
    sigma = np.sqrt(light * gain + read**2)
    return GrayImage(np.clip(np.rint(light + sigma * dice.standard_normal(light.shape)), 0, 255))


def opencv_diameters(image: GrayImage, scene: Picture) -> dict[str, float]:
    """What OpenCV's usual ways say of the same frame; NaN where they find nothing."""
    import cv2

    codes = image.codes.astype(np.uint8)
    binary = cv2.threshold(codes, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[1]
    if binary[round(scene.centre[1]), round(scene.centre[0])] == 0:
        binary = 255 - binary
    contours = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    found = {"fitEllipse": math.nan, "minEnclosingCircle": math.nan, "HoughCircles": math.nan}
    if contours:
        largest = max(contours, key=len)
        if len(largest) >= 5:
            found["fitEllipse"] = float(np.mean(cv2.fitEllipse(largest)[1]))
        found["minEnclosingCircle"] = 2 * float(cv2.minEnclosingCircle(largest)[1])
    low, high = int(scene.radius * 0.8), math.ceil(scene.radius * 1.2)
    circles = cv2.HoughCircles(
        codes, cv2.HOUGH_GRADIENT_ALT, 1.5, 1000, param1=100, param2=0.5, minRadius=low, maxRadius=high
    )
    if circles is not None:
        found["HoughCircles"] = 2 * float(circles[0][0][2])
    return found


def campaign(kind: str, span: tuple[float, float], scenes: int, frames: int, seed: int) -> Tally:
    """All scenes of a gauge in one class of blur."""
    tally = Tally()
    for number in range(scenes):
        dice = np.random.default_rng((seed, GAUGES.index(kind), BLURS.index(span), number))
        scene = picture(kind, dice, dice.uniform(*span))
        gain, read = dice.uniform(0.01, 0.1), dice.uniform(0.3, 1.5)
        errors, sigmas = [], []
        for each in range(frames):
            image = frame(scene.light, dice, gain, read)
            tally.frames += 1
            try:
                said = scene.measured(image)
            except InputError:
                tally.failed += 1
                continue
            tally.warned += said.warned
            of = "without a width" if said.value is None else "with a width"
            for name, z in zip(("place", "direction"), said.by_middle, strict=False):
                tally.by_middle.setdefault(f"{name} of those {of}", []).append(z)
            if said.value is None:
                tally.without_width += 1
                continue
            errors.append(said.value - scene.true)
            sigmas.append(said.sigma)
            if kind == "circle" and each < 2:
                for name, diameter in opencv_diameters(image, scene).items():
                    tally.others.setdefault(name, []).append(diameter - scene.true)
        if errors:
            # The mean of twenty frames has a fifth of one frame's sigma itself: bias is that of the light alone.
            try:
                exact = scene.measured(GrayImage(scene.light)).value
            except InputError:
                exact = None
            tally.exact.append(math.nan if exact is None else exact - scene.true)
            tally.z += list(np.array(errors) / np.array(sigmas))
            tally.bias.append(float(np.mean(errors)))
            tally.sigma.append(float(np.mean(sigmas)))
    return tally


def _line(kind: str, span: tuple[float, float], told: dict[str, Any]) -> str:
    if "z_mean" not in told:
        return f"{kind:7s} blur {span[0]:g} to {span[1]:g} px: none of {told['frames']} gave a number"
    return (
        f"{kind:7s} blur {span[0]:g} to {span[1]:g} px: z {told['z_mean']:+.2f}, sd {told['z_sd']:.2f}, "
        f"largest {told['z_largest']:.1f}; bias rms {told['bias_rms']:.4f} px of sigma {told['sigma_median']:.4f}, "
        f"without noise {told['bias_without_noise_rms']:.4f}, "
        f"small in {told['scenes_of_small_bias']:.0%}, refused {told['refused_without_noise']}; "
        f"failed {told['failed']}, without a width {told['without_width']}, warned {told['warned']} of "
        f"{told['frames']}"
    )


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200, help="of each gauge, in all classes of blur together")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--seed", type=int, default=2, help="1 was used while the gauges were made")
    parser.add_argument("--gauges", nargs="+", choices=GAUGES, default=GAUGES)
    parser.add_argument("--blurs", nargs="+", type=int, choices=range(len(BLURS)), default=range(len(BLURS)))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result: dict[str, Any] = {}
    for kind in (gauge for gauge in GAUGES if gauge in given.gauges):
        for span in (BLURS[number] for number in given.blurs):
            told = campaign(kind, span, math.ceil(given.scenes / len(BLURS)), given.frames, given.seed).told()
            result[f"{kind} {span[0]:g} to {span[1]:g} px"] = told
            print(_line(kind, span, told), flush=True)
            for name, of in told.get("by_middle", {}).items():
                print(f"        {name}: z {of['z_mean']:+.2f}, sd {of['z_sd']:.2f}, largest {of['z_largest']:.1f}")
            for name, rms in told.get("others_rms", {}).items():
                print(f"        {name}: rms {rms:.3f} px, median {told['others_median'][name]:+.3f}")
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
