"""A photometric bench for sheeting: R_A = L cos(nu)/E_perp of a patch, at the angles of ASTM E808 and E810.

The patch lies at the origin and faces +z. Light comes from the unit vector l at the entrance angle beta to the
normal; the viewer stands at the unit vector v, at the observation angle alpha to l, on any side of it.
"""

import math
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.validate.closed_forms.aperture import pinhole_exposure
from radwrap.validate.closed_forms.sheeting import (
    D4956_III_WHITE,
    WARD_PROFILE,
    glass_beads,
    light_direction,
    perturbed_normal_lobe,
    view_direction,
)

R_A_TOLERANCE = 1e-5  # asked for by the validation plan; the table's angles come from chords of float64
LOBE_TOLERANCE = 1e-6  # asked for by the validation plan; the tracer's answer is a float32
FLOAT32 = 3e-7

LAMP_DISTANCE, EYE_DISTANCE = 1.3, 1.0  # the lamp stands behind the viewer, who casts no shadow
INTENSITY = 0.5
PERPENDICULAR_IRRADIANCE = INTENSITY / LAMP_DISTANCE**2


def table(interpolation: str | None = "log", outside: str = "refuse") -> dict[str, Any]:
    rows = ((0.1, (-4, 30)), (0.2, (-4, 30)), (0.5, (-4, 30)))
    material: dict[str, Any] = {
        "type": "retroreflective",
        "model": "coefficient",
        "observation_angles": [f"{alpha} deg" for alpha, _ in rows],
        "entrance_angles": ["-4 deg", "30 deg"],
        "coefficients": [[f"{D4956_III_WHITE[alpha, beta]} cd/lx/m^2" for beta in betas] for alpha, betas in rows],
        "outside": outside,
    }
    return material | ({"interpolation": interpolation} if interpolation else {})


def beads(outside: str = "refuse") -> dict[str, Any]:
    material = {"type": "retroreflective", "model": "coefficient", "function": "glass_beads"}
    return material | {"anchor": "95 cd/lx/m^2", "outside": outside}


def patch_scene(
    bench: Any, material: dict[str, Any], beta: float, eye: np.ndarray, turned: float = 0.0
) -> radwrap.Scene:
    camera = bench.camera(EYE_DISTANCE * eye, focal_length=0.0125)
    lamp = bench.lamp(LAMP_DISTANCE * light_direction(beta), diameter=2e-4, radiant_intensity=INTENSITY)
    patch = {"type": "disc", "material": "patch", "diameter": "20 mm", "rotation": bench.degrees(turned, 0, 0)}
    return bench.scene(camera, [lamp], {"patch": material}, [patch])


def rendered_radiance(scene: radwrap.Scene) -> float:
    """L of the one pixel, from its radiant exposure by the infinitesimal pinhole: H = tau A/f^2 L."""
    exposure = radwrap.render(scene, method="pinhole").radiant_exposure.values[0, 0]
    return float(exposure) / pinhole_exposure(1.0, 1e-4, 0.0125)


def coefficient(
    bench: Any, material: dict[str, Any], alpha: float, beta: float, around: tuple[float, ...] = (0.0, 90.0, 180.0)
) -> np.ndarray:
    """R_A measured from several sides."""
    eyes = np.array([view_direction(alpha, beta, turn) for turn in around])
    scene = patch_scene(bench, material, beta, eyes[0])
    radiance = bench.radiance(scene, eyes * EYE_DISTANCE, np.zeros((len(eyes), 3)))
    return radiance * eyes[:, 2] / PERPENDICULAR_IRRADIANCE


@pytest.mark.parametrize(("alpha", "beta"), [(0.2, -4), (0.2, 30), (0.5, -4), (0.5, 30), (0.1, -4), (0.1, 30)])
@pytest.mark.parametrize("interpolation", ["linear", "log"])
def test_table_at_its_nodes_by_rendering(bench: Any, interpolation: str, alpha: float, beta: float) -> None:
    eye = view_direction(alpha, beta, around=90.0)
    radiance = rendered_radiance(patch_scene(bench, table(interpolation), beta, eye))
    assert radiance * eye[2] / PERPENDICULAR_IRRADIANCE == pytest.approx(
        D4956_III_WHITE[alpha, beta], rel=R_A_TOLERANCE
    )


@pytest.mark.parametrize("alpha", [0.716, 0.906])
def test_glass_beads_by_rendering(bench: Any, alpha: float) -> None:
    """The two observation angles under which the ring of 25 mm is seen, at 1 m and 0.79 m."""
    eye = view_direction(alpha, 0.0)
    radiance = rendered_radiance(patch_scene(bench, beads(), 0.0, eye))
    assert radiance * eye[2] / PERPENDICULAR_IRRADIANCE == pytest.approx(glass_beads(95, alpha), rel=R_A_TOLERANCE)


@pytest.mark.parametrize(
    ("interpolation", "alpha", "beta", "expected"),
    [
        ("linear", 0.15, -4, (300 + 250) / 2),
        ("log", 0.15, -4, math.sqrt(300 * 250)),
        ("linear", 0.35, 30, (150 + 65) / 2),
        ("log", 0.35, 30, math.sqrt(150 * 65)),
        ("linear", 0.2, 17, (250 + 150) / 2),
        ("log", 0.2, 17, math.sqrt(250 * 150)),
        ("linear", 0.35, 17, (250 + 150 + 95 + 65) / 4),
        ("log", 0.35, -17, (250 * 150 * 95 * 65) ** 0.25),
        ("linear", 0.275, 10.5, 0.75 * 225 + 0.25 * 87.5),  # a quarter of the way on both axes
        (None, 0.15, -4, math.sqrt(300 * 250)),  # the logarithm is the default
    ],
)
def test_table_between_its_nodes(
    bench: Any, interpolation: str | None, alpha: float, beta: float, expected: float
) -> None:
    measured = coefficient(bench, table(interpolation, "hold"), alpha, beta)
    assert measured == pytest.approx(np.full(3, expected), rel=R_A_TOLERANCE)


@pytest.mark.parametrize(
    ("alpha", "beta", "expected"), [(0.03, 4.0, 300), (0.9, 4.0, 95), (0.2, 50.0, 150), (0.2, 0.0, 250), (1.5, 70, 65)]
)
def test_held_at_the_edge_of_the_table(bench: Any, alpha: float, beta: float, expected: float) -> None:
    measured = coefficient(bench, table("linear", "hold"), alpha, beta)
    assert measured == pytest.approx(np.full(3, expected), rel=R_A_TOLERANCE)


@pytest.mark.parametrize(
    ("material", "alpha", "beta", "message"),
    [
        (table(), 0.09, 10.0, "observation angles 0.09 to"),
        (table(), 0.6, 10.0, "0.6 deg"),
        (table(), 0.2, 31.0, "entrance angles up to 31 deg"),
        (beads(), 0.05, 0.0, "observation"),
        (beads(), 2.2, 0.0, "observation"),
    ],
)
def test_refused_outside_the_data(
    bench: Any, material: dict[str, Any], alpha: float, beta: float, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        patch_scene(bench, material, beta, view_direction(alpha, beta, 90.0))


@pytest.mark.parametrize("alpha", WARD_PROFILE)
def test_glass_beads_at_their_nodes(bench: Any, alpha: float) -> None:
    for beta in (0.0, 20.0, -45.0):
        measured = coefficient(bench, beads(), alpha, beta)
        assert measured == pytest.approx(np.full(3, glass_beads(95, alpha, beta)), rel=R_A_TOLERANCE)


def test_glass_beads_between_their_nodes(bench: Any) -> None:
    """Straight in the logarithm."""
    expected = glass_beads(95, 1.25, 30.0)
    assert coefficient(bench, beads(), 1.25, 30.0) == pytest.approx(np.full(3, expected), rel=R_A_TOLERANCE)


@pytest.mark.parametrize("beta", [0.0, 4.0, 30.0, 60.0, 85.0])
@pytest.mark.parametrize(
    ("rho", "a", "alphas"),
    [
        (1.0, 0.002, (0.0, 0.1, 0.3, 0.5)),
        (0.6, 0.02, (0.0, 0.2, 0.716, 0.906, 2.0)),
        (0.3, 0.1, (0.0, 1.0, 4.0)),
        (0.9, 0.3, (0.0, 2.0, 4.9)),
    ],
)
def test_lobe_of_the_perturbed_normal(bench: Any, rho: float, a: float, alphas: tuple[float, ...], beta: float) -> None:
    material = {"type": "retroreflective", "model": "perturbed_normal", "reflectance": rho, "roughness": a}
    cases = [(alpha, turn) for alpha in alphas for turn in (0.0, 90.0, 180.0)]
    eyes = np.array([view_direction(alpha, beta, turn) for alpha, turn in cases])
    scene = patch_scene(bench, material, beta, eyes[0])
    measured = bench.radiance(scene, eyes * EYE_DISTANCE, np.zeros((len(eyes), 3))) / PERPENDICULAR_IRRADIANCE
    assert measured == pytest.approx(
        np.array([perturbed_normal_lobe(rho, a, alpha) for alpha, _ in cases]), rel=LOBE_TOLERANCE
    )


def test_width_of_the_lobe(bench: Any) -> None:
    """The peak is rho/(4 pi a^2); half of it is left at 2 atan(a sqrt(ln 2)), to second order in a."""
    a = 0.01
    material = {"type": "retroreflective", "model": "perturbed_normal", "reflectance": 0.6, "roughness": a}
    half_width = math.degrees(2 * math.atan(a * math.sqrt(math.log(2))))
    eyes = np.array([view_direction(alpha, 20.0) for alpha in (0.0, half_width)])
    scene = patch_scene(bench, material, 20.0, eyes[0])
    measured = bench.radiance(scene, eyes, np.zeros((2, 3))) / PERPENDICULAR_IRRADIANCE
    assert measured[0] == pytest.approx(0.6 / (4 * math.pi * a**2), rel=LOBE_TOLERANCE)
    assert measured[1] / measured[0] == pytest.approx(0.5, rel=a**2)


PERTURBED = {"type": "retroreflective", "model": "perturbed_normal", "reflectance": 0.9, "roughness": 0.3}


@pytest.mark.parametrize("material", [PERTURBED, table("linear", "hold"), beads("hold")])
def test_back_of_sheeting_is_black(bench: Any, material: dict[str, Any]) -> None:
    """The back is lit and seen, the back is lit and the front seen, the front is lit and the back seen."""
    beta, eye = 10.0, view_direction(0.5, 10.0)
    assert rendered_radiance(patch_scene(bench, material, beta, eye)) > 0.1
    back = patch_scene(bench, material, beta, eye, turned=180.0)
    behind = EYE_DISTANCE * eye * np.array([1.0, 1.0, -1.0])
    assert (bench.radiance(back, [EYE_DISTANCE * eye, behind], np.zeros((2, 3))) == 0).all()
    front = patch_scene(bench, material, beta, eye)
    assert (bench.radiance(front, [behind], np.zeros((1, 3))) == 0).all()


@pytest.mark.parametrize("beta", [0.0, 35.0, 80.0])
def test_lambertian_patch(bench: Any, beta: float) -> None:
    """E = pi L/rho, the same from all sides; E = E_perp cos(beta)."""
    rho = 0.18
    eyes = np.array([view_direction(alpha, 0.0, turn) for alpha, turn in ((0, 0), (30, 10), (60, 130), (85, 250))])
    scene = patch_scene(bench, {"type": "lambertian", "reflectance": rho}, beta, eyes[0])
    radiance = bench.radiance(scene, eyes * EYE_DISTANCE, np.zeros((len(eyes), 3)))
    irradiance = PERPENDICULAR_IRRADIANCE * math.cos(math.radians(beta))
    assert math.pi * radiance / rho == pytest.approx(np.full(len(eyes), irradiance), rel=FLOAT32)
    assert rendered_radiance(scene) == pytest.approx(rho * irradiance / math.pi, rel=FLOAT32)


def test_sheeting_under_the_ring_outshines_white(bench: Any) -> None:
    """Physics, section 4: R_A 72 gives 226 times the radiance of a white Lambertian surface, pi R_A."""
    eye = view_direction(0.716, 0.0)
    sheeting, white = (
        rendered_radiance(patch_scene(bench, material, 0.0, eye))
        for material in (beads(), {"type": "lambertian", "reflectance": 1.0})
    )
    assert sheeting / white == pytest.approx(math.pi * glass_beads(95, 0.716) / eye[2], rel=R_A_TOLERANCE)
    assert sheeting / white == pytest.approx(226, abs=1)
