"""Frames with noise, as files."""

from __future__ import annotations

from pathlib import Path

from radwrap.images import write_png
from radwrap.imaging.output.image_files import read_exposure
from radwrap.imaging.response.noise import fixed_pattern, frame_file, noisy_frame
from radwrap.scene.camera import Sensor


def write_frames(folder: Path, sensor: Sensor, number: int, seed: int) -> list[str]:
    """Write frames of the exposure as its file in this folder holds it; their names."""
    if not number:
        return []
    exposure = read_exposure(folder)
    pattern = fixed_pattern(sensor)
    names = [frame_file(k) for k in range(number)]
    for k, name in enumerate(names):
        write_png(folder / name, noisy_frame(exposure, sensor, pattern, seed, k).codes)
    return names
