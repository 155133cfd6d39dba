"""The wave's point spread by radwrap and by prysm, from the same opening and defocus.

Usage: prysm_waves.py --python /path/to/venv/bin/python [--samples 512]

prysm is no dependency: `python3 -m venv V && V/bin/pip install prysm`. Four shapes of opening, in focus and at three
Fresnel numbers of defocus; a round one behind glass, with each Zernike term up to order 4 by itself and all of them
together, in focus and out of it, the polynomials by prysm's own formulas. Radwrap transforms what passes of each
frequency; prysm transforms the pupil's field, of which each sample has the share of it that the opening covers.
Intensities over the peak in focus are compared at 41 x 41 places; 1 is returned where they differ by 1e-4 of it.
prysm's own error falls with the number of samples.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

WAVELENGTH, DISTANCE, DIAMETER = 550e-9, 12.5e-3, 0.1e-3  # m
SPREAD = WAVELENGTH * DISTANCE / DIAMETER  # lambda N_w
INNER, ROTATION = 0.4, {"round": 0.0, "annular": 0.0, "square": 0.3, "half_disc": 0.5}
FRESNEL = (0.0, 0.37, 2.0, 6.0)  # a^2 D/lambda
PLACES, STEP = 41, 0.25  # a side; lambda N_w
PERIOD = 128  # of the frequencies' sum, in lambda N_w: beyond its half less than 3e-5 of the peak is left
FINER = 16  # places along a side of a sample of the pupil that tell its share
WIDE = 1.45  # side of the pupil's grid over the diameter: a turned square reaches beyond it
LIMIT = 1e-4
# Zernike terms of osa, rms over the pupil in waves: each, and all together with a defocus of this Fresnel number.
TERMS, EACH, TOGETHER, OUT_OF_FOCUS = range(1, 15), 0.12, 0.05, 0.37


def main() -> int:
    """Compare, and print a line for each opening and defocus."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default="python3", help="Python that has prysm")
    parser.add_argument("--samples", type=int, default=512, help="of the pupil, along a side")
    parser.add_argument("--by-prysm", metavar="FILE", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.by_prysm:
        np.savez(arguments.by_prysm, **_by_prysm(arguments.samples))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "psf.npz"
        ran = subprocess.run(
            [arguments.python, __file__, "--samples", str(arguments.samples), "--by-prysm", str(file)],
            capture_output=True,
            text=True,
            check=False,
        )
        if ran.returncode:
            print(f"error: prysm did not run: {ran.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
            return 4
        theirs = dict(np.load(file))
    worst = 0.0
    for name, ours in _by_radwrap().items():
        apart = float(np.abs(ours - theirs[name]).max())
        worst = max(worst, apart)
        print(f"{name:16}: highest {ours.max():.5f} of the peak in focus, apart by {apart:.1e} of it")
    return int(worst > LIMIT)


def _by_radwrap() -> dict[str, Any]:
    from radwrap.imaging.optics.waves import Waves
    from radwrap.scene.camera import Aperture

    found = {}
    for shape, rotation in ROTATION.items():
        inner = INNER * DIAMETER if shape == "annular" else 0.0
        waves = Waves(Aperture(shape, DIAMETER, rotation=rotation, inner_diameter=inner), DISTANCE, WAVELENGTH)  # type: ignore[arg-type]
        step = 1 / (PERIOD * SPREAD)
        count = int(waves.highest_frequency / step) + 1
        frequency = np.arange(-count, count + 1) * step
        place = (np.arange(PLACES) - PLACES // 2) * STEP * SPREAD
        across = np.exp(2j * np.pi * np.outer(place, frequency)) * step
        peak = waves.aperture.area / (WAVELENGTH * DISTANCE) ** 2
        for fresnel in FRESNEL:
            magnification = fresnel * WAVELENGTH * DISTANCE / (DIAMETER / 2) ** 2
            passed = waves.transfer(magnification, frequency[np.newaxis], frequency[:, np.newaxis])
            found[f"{shape} {fresnel:g}"] = (across @ passed @ across.T).real / peak
        if shape == "round":
            found |= {
                f"osa {name}": (
                    across
                    @ replace(waves, glass=_glass(coefficients)).transfer(
                        fresnel * WAVELENGTH * DISTANCE / (DIAMETER / 2) ** 2,
                        frequency[np.newaxis],
                        frequency[:, np.newaxis],
                    )
                    @ across.T
                ).real
                / peak
                for name, (coefficients, fresnel) in _glasses().items()
            }
    return found


def _glasses() -> dict[str, tuple[dict[int, float], float]]:
    """Coefficients in waves, and the Fresnel number of the defocus beside them."""
    alone = {str(index): ({index: EACH}, 0.0) for index in TERMS}
    signs = {index: TOGETHER * (-1) ** (index // 3) for index in TERMS}
    return alone | {"all": (signs, 0.0), "all, out of focus": (signs, OUT_OF_FOCUS)}


def _glass(coefficients: dict[int, float]) -> Any:
    from radwrap.imaging.optics.pupil_path import PupilPath
    from radwrap.scene.zernike import order_of

    orders = tuple(order_of("osa", index) for index in coefficients)
    return PupilPath(DIAMETER / 2, orders, tuple(value * WAVELENGTH for value in coefficients.values()))  # type: ignore[arg-type]


def _by_prysm(samples: int) -> dict[str, Any]:
    from prysm.polynomials import ansi_j_to_nm, zernike_nm

    side = samples * FINER
    fine = (np.arange(side) - (side - 1) / 2) * WIDE * DIAMETER / side
    coarse = (np.arange(samples) - samples // 2) * WIDE * DIAMETER / samples
    # prysm's middle is a sample, ours lies between two of the fine grid.
    fine += coarse[0] - fine[:FINER].mean()
    found = {}
    for shape, rotation in ROTATION.items():
        c, s = np.cos(rotation), np.sin(rotation)
        share = np.empty((samples, samples))
        for row in range(samples):
            x, y = np.meshgrid(fine, fine[row * FINER : (row + 1) * FINER])
            inside = _inside(shape, c * x + s * y, c * y - s * x)
            share[row] = inside.reshape(FINER, samples, FINER).mean(axis=(0, 2))
        square = (coarse[:, np.newaxis] ** 2 + coarse[np.newaxis] ** 2) / (DIAMETER / 2) ** 2
        focused = _intensity(share, 0 * square).max()
        for fresnel in FRESNEL:
            found[f"{shape} {fresnel:g}"] = _intensity(share, fresnel * square / 2) / focused
        if shape == "round":
            rho, theta = np.sqrt(square), np.arctan2(-coarse[:, np.newaxis], coarse[np.newaxis])  # rows go down
            for name, (coefficients, fresnel) in _glasses().items():
                terms = (
                    value * zernike_nm(*ansi_j_to_nm(index), rho, theta, norm=True)
                    for index, value in coefficients.items()
                )
                found[f"osa {name}"] = _intensity(share, fresnel * square / 2 + sum(terms)) / focused
    return found


def _intensity(share: Any, waves: Any) -> Any:
    """Behind a pupil of these amplitudes and paths [waves]."""
    from prysm.propagation import Wavefront

    nm, um, mm = 1e9, 1e6, 1e3
    pupil = Wavefront.from_amp_and_phase(
        share, waves * WAVELENGTH * nm, WAVELENGTH * um, WIDE * DIAMETER * mm / len(share)
    )
    return np.asarray(pupil.focus_fixed_sampling(DISTANCE * mm, STEP * SPREAD * um, PLACES).intensity.data)


def _inside(shape: str, x: Any, y: Any) -> Any:
    """Whether the opening has these places [m]."""
    radius = np.hypot(x, y)
    if shape == "square":
        return np.maximum(np.abs(x), np.abs(y)) <= DIAMETER / 2
    whole = radius <= DIAMETER / 2
    if shape == "annular":
        return whole & (radius >= INNER * DIAMETER / 2)
    return whole & (x >= 0) if shape == "half_disc" else whole


if __name__ == "__main__":
    sys.exit(main())
