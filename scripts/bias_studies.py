"""Bias of algorithms on predicted images, one change at a time; writes out/bias/NAME.json and NAME.png.

Dots: centre method against blur, saturation, threshold (the gray level taken for dark) and tilt.
Edge: way of fitting against gamma, light gradient and pinhole.
"""

from __future__ import annotations

import sys
from pathlib import Path

import radwrap
from radwrap.images import ExposureImage
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_image
from radwrap.measure.dots import METHODS
from radwrap.scene.scene import Scene
from radwrap.study.bias import BiasPoint, Study, dot_bias, edge_bias, scaled_gray, sweep, write_study

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "bias"
BOARD = ROOT / "rad_scenes" / "bench_board" / "scene.toml"
EDGE = ROOT / "rad_scenes" / "fig11_edge" / "scene.toml"
OPTIONS = RenderOptions(viewpoints=37)
# An edge is fitted to hundredths of a pixel: the steps of sub-viewpoints would be the picture's bias, not the fit's.
SMOOTH = RenderOptions(method="kernel", tolerance=0.03)

# Far from saturation also under the widest beam; rows and columns that the widest blur needs.
ROOM = {"camera.exposure_time": "250 ms", "camera.sensor.rows": 40, "camera.sensor.columns": 100}
BRIGHTEST = 160.0  # gray level to which each edge is exposed: a clipped edge would be a study of saturation
EDGE_METHODS = {
    "gamma fitted": {"dark": 22.0},
    "gamma 0.85": {"dark": 22.0, "gamma": 0.85},
    "gamma 1": {"dark": 22.0, "gamma": 1.0},
}


def _dots(value: float, scene: Scene, exposure: ExposureImage) -> list[BiasPoint]:
    return dot_bias(value, scene, gray_image(exposure, scene.camera.sensor), METHODS)


def _edge(value: float, scene: Scene, exposure: ExposureImage) -> list[BiasPoint]:
    sensor = scene.camera.sensor
    wanted = ((BRIGHTEST - sensor.dark_gray) / sensor.gain) ** (1 / sensor.gamma)
    image = scaled_gray(exposure, wanted / float(exposure.values.max()), sensor)
    return edge_bias(value, scene, image, EDGE_METHODS)


def dots_against_blur() -> Study:
    """The light that passes is kept the same, so that blur alone changes."""
    points: list[BiasPoint] = []
    for diameter in (0.02, 0.04, 0.06, 0.08, 0.1, 0.12):
        changes = {
            "camera.aperture.diameter": f"{diameter} mm",
            "camera.exposure_time": f"{387 * (0.1 / diameter) ** 2!r} ms",
        }
        scene = radwrap.load_scene(BOARD, changes)
        points += _dots(diameter, scene, radwrap.render(scene, options=OPTIONS).radiant_exposure)
    return Study("dots_blur", "Dot centres against blur (fig13 board)", "pinhole diameter [mm]", tuple(points))


def dots_against_saturation() -> Study:
    """One rendering: exposure is proportional to time."""
    scene = radwrap.load_scene(BOARD)
    exposure = radwrap.render(scene, options=OPTIONS).radiant_exposure
    points: list[BiasPoint] = []
    for time in (100, 200, 387, 500, 700, 1000, 1500):
        points += dot_bias(time, scene, scaled_gray(exposure, time / 387, scene.camera.sensor), METHODS)
    return Study("dots_saturation", "Dot centres against saturation (fig13 board)", "exposure time [ms]", tuple(points))


def dots_against_threshold() -> Study:
    """The gray level that the algorithm takes for dark; the sensor's is 22."""
    scene = radwrap.load_scene(BOARD)
    image = radwrap.render(scene, options=OPTIONS).gray
    points: list[BiasPoint] = []
    for dark in (15.0, 20.0, 22.0, 24.0, 30.0, 40.0, 50.0):
        points += dot_bias(dark, scene, image, METHODS, dark=dark)
    return Study("dots_threshold", "Dot centres against the level taken for dark", "dark [gray level]", tuple(points))


def dots_against_tilt() -> Study:
    """The board turned about its x axis."""
    values = [(tilt, [f"{tilt} deg", "6 deg", "-2 deg"]) for tilt in (0.0, 15.0, 30.0, 46.0, 55.0)]
    points = sweep(radwrap.load_scene(BOARD), "targets[0].rotation", values, OPTIONS, _dots)
    return Study("dots_tilt", "Dot centres against tilt (d_p 0.1 mm)", "rotation about x [deg]", points)


def edge_against_gamma() -> Study:
    """The sensor's gamma changes, its gain keeps the peak gray; what the fit takes for gamma is the method."""
    scene = radwrap.load_scene(EDGE, ROOM)
    exposure = radwrap.render(scene, options=SMOOTH).radiant_exposure
    peak = float(exposure.values.max())
    points: list[BiasPoint] = []
    for gamma in (0.45, 0.6, 0.7, 0.8, 0.85, 0.9, 1.0):
        gain = 140 / peak**gamma
        changes = {**ROOM, "camera.sensor.gamma": gamma, "camera.sensor.gain": f"{gain!r} (J/m^2)^-{gamma}"}
        points += _edge(gamma, radwrap.load_scene(EDGE, changes), exposure)
    return Study("edge_gamma", "Edge position against the sensor's gamma", "gamma", tuple(points))


def edge_against_light_gradient() -> Study:
    """Narrower beams make the light fall off faster on both sides of the axis; the edge lies 20 mm beside it."""
    base = radwrap.load_scene(EDGE, {**ROOM, "targets[0].edge_position": "20 mm"})
    values = [(width, f"{width} deg") for width in (4.0, 5.0, 7.0, 10.0, 15.0, 25.0)]
    points = sweep(base, "sources[0].beam.width", values, SMOOTH, _edge)
    return Study("edge_gradient", "Edge position against the light's gradient", "beam width, fwhm [deg]", points)


def edge_against_pinhole() -> Study:
    """Wider pinholes blur more; the light that passes is kept the same."""
    points: list[BiasPoint] = []
    for diameter in (0.03, 0.05, 0.1, 0.15, 0.2, 0.3):
        changes = {
            **ROOM,
            "camera.aperture.diameter": f"{diameter} mm",
            "camera.exposure_time": f"{250 * (0.1 / diameter) ** 2!r} ms",
        }
        scene = radwrap.load_scene(EDGE, changes)
        points += _edge(diameter, scene, radwrap.render(scene, options=SMOOTH).radiant_exposure)
    return Study("edge_pinhole", "Edge position against the pinhole", "pinhole diameter [mm]", tuple(points))


STUDIES = (
    dots_against_blur,
    dots_against_saturation,
    dots_against_threshold,
    dots_against_tilt,
    edge_against_gamma,
    edge_against_light_gradient,
    edge_against_pinhole,
)


def main(names: list[str]) -> int:
    """Run the named studies, or all."""
    OUT.mkdir(parents=True, exist_ok=True)
    for make in STUDIES:
        if names and make.__name__ not in names:
            continue
        study = make()
        numbers, picture = write_study(study, OUT)
        print(f"{study.title}: {numbers}, {picture}")
        for point in study.points:
            told = (
                point.failure or f"bias ({point.bias_u:+.4f}, {point.bias_v:+.4f}) px, scatter {point.scatter:.4f} px"
            )
            print(f"  {study.axis.split(' [')[0]} {point.value:g}, {point.method}: {told}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
