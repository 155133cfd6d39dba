"""The thin lens against ``rpict -pd``, which draws points of a lens focused at the length of -vd: z-test by pixels."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radwrap.frames import Pose
from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.view import rays_through
from radwrap.process import Limits, Programs
from radwrap.scene.camera import Aperture, Camera, Lens, Sensor
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import NO_LIGHT, RadianceOptions, RadianceTracer, build
from radwrap.tracers.radiance_text import RadianceScene
from radwrap.tracers.text_frame import TextFrame

F, FOCUS, DIAMETER = 0.0125, 0.5, 0.00625  # f/2
ROWS, COLUMNS, PITCH = 20, 30, 60e-6
SIDE = 20  # rays of each pixel along each side
RAYS = 512  # of ours, of each pixel
# Largest |z| of 600 pixels: beyond 5 by chance once in 2800 runs, which a wrong lens passes by far.
LARGEST_Z = 5.0

# Bright and dark panes, in mm, which shine towards the camera: in the plane of focus, behind it, and one before it
# that hides part of them.
TEXT = """
void glow bright 0 0 4 1 1 1 0
void glow dark 0 0 4 0.25 0.25 0.25 0
bright polygon in_focus 0 0 12  -40 2 500  -3 2 500  -3 -30 500  -40 -30 500
dark polygon in_focus_dark 0 0 12  -40 30 500  -3 30 500  -3 2 500  -40 2 500
dark polygon behind 0 0 12  -40 95 1500  2 95 1500  2 -90 1500  -40 -90 1500
bright polygon behind_bright 0 0 12  2 95 1500  130 95 1500  130 -90 1500  2 -90 1500
dark polygon before 0 0 12  -6 -2 250  12 -2 250  12 -6 250  -6 -9 250
"""


@pytest.fixture
def tracer(tmp_path: Path) -> Any:
    """rtrace on the panes."""
    with Programs() as programs:
        options = RadianceOptions(find_radiance())
        build(TEXT, {}, tmp_path, options, programs, harmless=(NO_LIGHT,))
        scene = RadianceScene(TEXT, {}, TextFrame())
        yield RadianceTracer(options, programs, tmp_path, scene, harmless=(NO_LIGHT,))


def camera(focus: float) -> Camera:
    sensor = Sensor(ROWS, COLUMNS, PITCH, PITCH, 1.0, 1.0, 0.0, 255.0)
    pose = Pose((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    centre = ((COLUMNS - 1) / 2, (ROWS - 1) / 2)
    return Camera(pose, F, centre, 1.0, Aperture("round", DIAMETER), sensor, lens=Lens(focus))


def ours(tracer: RadianceTracer, focus: float) -> np.ndarray:
    """Share of each pixel's rays that meet something bright."""
    seen = camera(focus)
    v, u = np.divmod(np.arange(seen.sensor.pixels, dtype=float), COLUMNS)
    opening, places_u, places_v = rays_over(seen, u, v, RAYS, np.random.default_rng(1))
    rays, _ = rays_through(seen, opening, places_u, places_v)
    values = np.concatenate(list(tracer.trace(np.array_split(rays, 40))))
    return (values > 0.6).reshape(len(u), -1).mean(axis=1)


def theirs(tracer: RadianceTracer, folder: Path) -> np.ndarray:
    """The same by rpict, one ray for each of SIDE x SIDE small pixels."""
    image_distance = F * FOCUS / (FOCUS - F)
    view = {"-vh": COLUMNS, "-vv": ROWS}
    angles = [
        word
        for key, count in view.items()
        for word in (key, repr(math.degrees(2 * math.atan(count * PITCH / 2 / image_distance))))
    ]
    size = ["-x", str(COLUMNS * SIDE), "-y", str(ROWS * SIDE), "-pa", "0", "-ps", "1", "-pj", "1", "-ab", "0"]
    where = ["-vtv", "-vp", "0", "0", "0", "-vd", "0", "0", repr(1e3 * FOCUS), "-vu", "0", "-1", "0"]
    installation = tracer.options.installation
    words = [*where, *angles, *size, "-pd", repr(1e3 * DIAMETER), "-w", "scene.oct"]
    picture, _ = tracer.programs.run(
        [installation.program("rpict"), *words], folder=folder, environment=installation.environment(), limits=Limits()
    )
    values, _ = tracer.programs.run(
        [installation.program("pvalue"), "-h", "-H", "-df", "-b"],
        folder=folder,
        environment=installation.environment(),
        stdin=[picture],
        limits=Limits(),
    )
    small = np.frombuffer(values, dtype=np.float32).reshape(ROWS, SIDE, COLUMNS, SIDE)
    return np.asarray((small > 0.6).mean(axis=(1, 3)).ravel())


def test_each_pixel_agrees_with_rpict(tracer: RadianceTracer, tmp_path: Path) -> None:
    """Shares of bright rays; the deviation of theirs is that of strata at most a binomial's."""
    other = theirs(tracer, tmp_path)
    assert 0.2 < other.mean() < 0.8 and ((other > 0.05) & (other < 0.95)).sum() > 100  # much is blurred
    for focus, agrees in ((FOCUS, True), (0.9, False)):
        share = ours(tracer, focus)
        deviation = np.sqrt(np.maximum(share * (1 - share), 1e-3) * (1 / SIDE**2 + 1 / RAYS))
        z = (share - other) / deviation
        assert (np.abs(z).max() < LARGEST_Z) == agrees
        print(f"focus {focus}: z rms {z.std():.2f}, largest {np.abs(z).max():.2f}, mean {np.mean(share - other):.1e}")
        if agrees:
            assert z.std() < 1.1
            assert abs(np.mean(share - other)) < 5 * math.sqrt(np.mean(deviation**2) / len(share))
