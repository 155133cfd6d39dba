"""Section 7: Eq. 5 and its inverse, Eq. 7, and the linear camera of EMVA 1288."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.calibrate.response import fit_response
from radwrap.errors import InputError
from radwrap.images import read_image
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels, radiant_exposure_of
from radwrap.imaging.synthesis import render
from radwrap.random_streams import generator
from radwrap.scene.camera import Sensor
from radwrap.scene.scene import Scene
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Missing, Plot
from radwrap.validate.closed_forms.sensor import ROUNDING, photons, power_law, transfer_mean, transfer_variance

Array = NDArray[np.float64]

_EXACT: Final = 1e-12
_NOISE_FREE: Final = 1e-9
_SEEDS: Final = 200
_THREE_SIGMA: Final = 0.98  # 99.73 % if variances were known: of 200 four may miss
_K, _GAMMA, _DARK, _SATURATION = 3.38e4, 0.85, 22.0, 181.0  # Sec. 4.1 of the paper
_GAMMAS: Final = (0.1, 0.45, 0.85, 1.0, 2.2, 3.0)


def _eq5(bench: Bench) -> Iterator[Finding]:
    exposures = np.array([1e-12, 1.83e-3, 0.017, 0.5, 1.0, 2.0])
    forward = back = 0.0
    plain = Sensor(1, 1, 1e-5, 1e-5, 400.0, 1.0, 22.0, 4095.0, bit_depth=12, rounding=False)
    for sensor in (replace(plain, gamma=gamma) for gamma in _GAMMAS):
        gray = gray_levels(exposures, sensor)
        law = {"gain": sensor.gain, "gamma": sensor.gamma, "dark_gray": sensor.dark_gray}
        expected = np.array([power_law(exposure, **law) for exposure in exposures.tolist()])
        forward = max(forward, float(np.abs(gray / expected - 1).max()))
        # A level close above dark has lost digits of H to the sum.
        kept = (gray - sensor.dark_gray) * sensor.gamma / gray > 1e-3
        again = radiant_exposure_of(gray[kept], sensor)
        back = max(back, float(np.abs(again / exposures[kept] - 1).max()))
    bench.tick()
    yield Case("7.eq5", "in 40 decimal digits; the largest relative error", 0.0, forward, _EXACT, "absolute")
    yield Case("7.eq5_inverse", "H of G of H; the largest relative error", 0.0, back, _EXACT, "absolute")


def _response(exposure: Array) -> Array:
    levels: Array = np.minimum(_K * exposure**_GAMMA + _DARK, _SATURATION)
    return levels


def _eq7(bench: Bench) -> Iterator[Finding]:
    exposure = np.linspace(0, 0.032, 33) * 0.0471 / 0.8**2
    exact = fit_response(exposure, _response(exposure), quantisation=0)
    source = "the paper's K and gamma, noise-free frames"
    for name, fit in (("eq7", exact.eq7), ("direct", exact.direct)):
        yield Case(f"7.{name}_gain", source, _K, fit.gain, _NOISE_FREE)
        yield Case(f"7.{name}_gamma", source, _GAMMA, fit.gamma, _NOISE_FREE)
    repeated = np.repeat(exposure[::2], 4)
    pulls = []
    for seed in range(_SEEDS):
        noise = generator(seed).standard_normal(len(repeated))
        found = fit_response(repeated, np.rint(_response(repeated) + noise))
        fit = found.eq7
        pulls.append(
            (math.log(fit.gain / _K) / math.sqrt(fit.covariance[0, 0]), (fit.gamma - _GAMMA) / fit.sigma["gamma"])
        )
        bench.tick()
    inside = (np.abs(pulls) < 3).mean(axis=0)
    for name, share in zip(("gain", "gamma"), inside.tolist(), strict=True):
        source = f"share of {_SEEDS} seeds within 3 sigma"
        yield Case(f"7.eq7_{name}_coverage", source, 0.9973, share, _THREE_SIGMA, "at least")
    order = np.linspace(0, 1, _SEEDS)
    curves = {name: (np.sort([pull[column] for pull in pulls]), order) for column, name in enumerate(("ln K", "gamma"))}
    line = np.linspace(-4, 4, 201)
    curves["reference: normal"] = (line, np.array([(1 + math.erf(x / math.sqrt(2))) / 2 for x in line.tolist()]))
    yield Plot("Eq. 7 from noisy frames: deviations over their sigma", "sigma", "share below", curves)


# A linear camera: even fields of `_PHOTONS` a pixel, from 0 to the full well.
_GAIN, _OFFSET, _EFFICIENCY, _READ, _FULL = 0.25, 100.0, 0.6, 8.0, 12_000.0
_SIDES: Final = (240, 300)
_LEVELS: Final = (0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8)  # of the full well
_EMVA: Final = ("mean", "variance", "snr_max", "gain", "read_noise")
_TIME, _WAVELENGTH, _PITCH = 0.02, 650e-9, 5e-6


def _linear_scene(electrons: float) -> Scene:
    """An even field, a far disc that fills the view, of so many electrons a pixel; the angle of view is small."""
    sensor = {
        "model": "linear",
        "bit_depth": 12,
        "wavelength": "650 nm",
        "quantum_efficiency": _EFFICIENCY,
        "system_gain": f"{_GAIN} DN/e",
        "offset": _OFFSET,
        "full_well": f"{_FULL} e",
        "read_noise": f"{_READ} e",
    }
    sensor |= {"rows": _SIDES[0], "columns": _SIDES[1], "pixel_width": "5 um", "pixel_height": "5 um"}
    exposure = max(electrons, 1e-6) / _EFFICIENCY / photons(1.0, _PITCH**2, _WAVELENGTH)
    radiance = exposure / (_TIME * math.pi / 4 * on.DIAMETER**2 / 0.5**2)
    camera = on.camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    camera |= {"sensor": sensor, "exposure_time": f"{_TIME} s", "focal_length": "0.5 m"}
    sky: dict[str, Any] = {"type": "disc", "name": "sky", "diameter": "2 m", "radiance": f"{radiance!r} W/m^2/sr"}
    sky |= {"position": on.metres(0, 0, 1), "look_at": on.metres(0, 0, 0)}
    behind = on.sheet(1.0) | {"position": on.metres(0, 0, 2)}
    return on.scene(camera, [sky], {"it": on.lambertian(0.05)}, [behind])


def _frames(bench: Bench, electrons: float) -> Array:
    """Two frames of gray levels, shape (2, rows, columns)."""
    if "frames" not in RenderOptions.__dataclass_fields__:
        raise Missing("the linear camera of EMVA 1288, and render with frames of noise")
    try:
        scene = _linear_scene(electrons)
    except InputError as error:
        raise Missing(f"the linear camera of EMVA 1288: {error}") from error
    how: dict[str, Any] = {"method": "pinhole", "frames": 2}
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
        render(scene, Path(folder), bench.options, **how)
        bench.tick()
        return np.stack([read_image(Path(folder) / f"frame_{i:04d}.png")[0].astype(np.float64) for i in range(2)])


def _emva(bench: Bench) -> Iterator[Finding]:
    """Photon transfer from pairs of frames: half the variance of their difference against their mean."""
    pairs = [_frames(bench, level * _FULL) for level in _LEVELS]
    mean = np.array([float(pair.mean()) for pair in pairs])
    variance = np.array([float(((pair[0] - pair[1]) ** 2).mean() / 2) for pair in pairs])
    electrons = _FULL * np.array(_LEVELS)
    expected = transfer_mean(electrons, gain=_GAIN, offset=_OFFSET)
    noise = transfer_variance(electrons, gain=_GAIN, read_noise=_READ)
    # cos^4 over the field is 1 to 1e-5; an average of 144 000 values has a standard error of 1e-4 of the mean.
    worst = int(np.abs(mean / expected - 1).argmax())
    yield Case("7.emva_mean", "mu_dark + K eta mu_p; the worst of 8", float(expected[worst]), float(mean[worst]), 1e-3)
    worst = int(np.abs(variance / noise - 1).argmax())
    ours = float(variance[worst])
    # 72 000 pairs tell a variance to 0.53 % (1 sigma): of eight, 2 % is beyond 3.7 sigma.
    yield Case("7.emva_variance", "K^2 sd^2 + 1/12 + K (mu_y - mu_dark); worst", float(noise[worst]), ours, 0.02)
    full = _frames(bench, 0.97 * _FULL)
    signal = (full.mean() - _OFFSET) / math.sqrt(((full[0] - full[1]) ** 2).mean() / 2)
    near = 0.97 * _FULL
    shot = _GAIN * near / math.sqrt(transfer_variance(near, gain=_GAIN, read_noise=_READ))
    yield Case("7.emva_snr_max", "sqrt(mu_e.sat), at 97 % of it", shot, float(signal), 0.01)
    slope = np.polyfit(mean - mean[0], variance - variance[0], 1, w=1 / (variance + 1))[0]
    yield Case("7.emva_gain", "photon transfer", _GAIN, float(slope), 0.005)
    dark = math.sqrt(max(float(variance[0]) - ROUNDING, 0.0)) / _GAIN
    yield Case("7.emva_read_noise", "dark frames", _READ, dark, 0.02)
    yield Plot(
        "Photon transfer of a linear camera",
        "mean [DN]",
        "variance [DN^2]",
        {"radwrap": (mean, variance), "reference": (expected, noise)},
    )


CHECKS: Final = (
    Check("7.eq5", ("7.eq5", "7.eq5_inverse"), _eq5),
    Check(
        "7.eq7",
        (
            *(f"7.{fit}_{name}" for fit in ("eq7", "direct") for name in ("gain", "gamma")),
            "7.eq7_gain_coverage",
            "7.eq7_gamma_coverage",
        ),
        _eq7,
    ),
    Check("7.emva", tuple(f"7.emva_{name}" for name in _EMVA), _emva),
)
