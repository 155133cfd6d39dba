"""Wide sources: cut into patches that fill the shape, or refused with one clear error."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.look.checks import warnings_of
from radwrap.scene.look.wide_sources import MOST_PATCHES, divided
from radwrap.scene.sources import Patch, WideSource
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, area, corners, first_cells, halves, nodes

SIDES = 1e-4  # arcs are drawn with 384 sides a turn: 4.5e-5 of their area
FLAT = 0.04  # flat patches of a sphere after five halvings
QUADRATURE = 1e-6  # 4 x 4 nodes in cells of at most a quarter of a turn
SHAPES = (
    Rectangle(0.1, 0.03),
    Annulus(0.0, 0.05),
    Annulus(0.045, 0.05),
    Zone(0.1, 0.2, math.pi / 2),
    Zone(1, 0, math.pi),
)
DOCUMENT: dict[str, Any] = {
    "camera": {
        "position": ["0 mm", "0 mm", "500 mm"],
        "look_at": ["0 mm", "0 mm", "0 mm"],
        "focal_length": "12.5 mm",
        "exposure_time": "5 ms",
        "sensor": {"preset": "fivs"},
    },
    "materials": {"white": {"type": "lambertian", "reflectance": 0.5}},
    "targets": [{"type": "sheet", "name": "sheet", "material": "white", "size": ["40 mm", "30 mm"]}],
}
PLACE = {"position": ["0 mm", "0 mm", "100 mm"], "look_at": ["0 mm", "0 mm", "0 mm"], "radiance": "100 W/m^2/sr"}
RECTANGLE = {"type": "rectangle", "name": "wide", "size": ["100 mm", "50 mm"], **PLACE}


def scene(source: dict[str, Any], **changes: Any) -> radwrap.Scene:
    """With patches, as Radiance has it."""
    return divided(radwrap.scene_from_document({**DOCUMENT, "sources": [source]}, changes or None))


def newell(vertices: np.ndarray) -> np.ndarray:
    away = vertices - vertices[0]
    normal: np.ndarray = np.cross(away, np.roll(away, -1, axis=0)).sum(axis=0) / 2
    return normal


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_patches_fill_the_shape_and_shine_from_within(shape: WideShape) -> None:
    cells = first_cells(shape)
    for _ in range(5):
        cells = [half for cell in cells for half in halves(shape, cell)]
    total = 0.0
    for cell in cells:
        patch = corners(shape, cell)
        normal = newell(patch)
        total += float(np.linalg.norm(normal))
        middle = patch.mean(axis=0)
        towards = -middle if isinstance(shape, Zone) else np.array([0.0, 0.0, 1.0])
        assert normal @ towards > 0
        # The middle lies in the patch: all corners turn about it one way.
        around = np.cross(patch - middle, np.roll(patch, -1, axis=0) - middle)
        assert (around @ normal > 0).all()
    assert total == pytest.approx(area(shape), rel=FLAT if isinstance(shape, Zone) else SIDES)
    assert float(nodes(shape, np.array(cells), 4)[2].sum()) == pytest.approx(area(shape), rel=QUADRATURE)


def test_more_is_asked_more_patches_stand_for_it() -> None:
    counts = []
    for error in (0.1, 0.01, 0.001):
        (wide,) = scene({**RECTANGLE, "irradiance_error": error}).sources
        assert isinstance(wide, WideSource) and wide.reached <= error
        assert math.fsum(patch.radiant_intensity for patch in wide.patches) == pytest.approx(100 * 0.1 * 0.05)
        counts.append(len(wide.patches))
    assert counts == sorted(counts) and counts[0] < counts[-1]


def test_least_patches_are_kept_and_make_half_shadows_finer() -> None:
    ball = {"targets": [*DOCUMENT["targets"], {"type": "sphere", "material": "white", "diameter": "10 mm"}]}
    told = []
    for least in (1, 500):
        source = {**RECTANGLE, "least_patches": least}
        made = divided(radwrap.scene_from_document({**DOCUMENT, **ball, "sources": [source]}))
        (wide,) = made.sources
        assert isinstance(wide, WideSource) and len(wide.patches) >= least
        told.append([line for line in warnings_of(made) if "half shadows" in line])
    assert told[0] and not told[1]


def test_a_disc_asked_for_an_error_is_cut() -> None:
    disc = {"type": "disc", "name": "disc", "diameter": "100 mm", **PLACE}
    with pytest.raises(InputError, match=r"too wide for its distance.*irradiance_error"):
        scene(disc)
    assert all(isinstance(emitter, Patch) for emitter in scene({**disc, "irradiance_error": 0.01}).emitters)


@pytest.mark.parametrize("shape", SHAPES)
def test_even_the_first_cells_have_an_area(shape: WideShape) -> None:
    """A cell from pole to pole had none but by rounding, and far from the origin not even that."""
    for cell in first_cells(shape):
        ends = corners(shape, cell)
        doubled = np.sum(np.cross(ends, np.roll(ends, -1, axis=0)), axis=0)
        assert np.linalg.norm(doubled) / 2 > 0.01 * area(shape) / len(first_cells(shape))


def test_a_surround_holds_everything() -> None:
    made = scene({"type": "surround", "name": "sky", "radiance": "1 W/m^2/sr"})
    (sky,) = made.sources
    assert isinstance(sky, WideSource) and isinstance(sky.shape, Zone)
    away = np.linalg.norm(np.asarray(made.camera.pose.position) - sky.pose.position)
    assert away < 0.6 * sky.shape.radius


@pytest.mark.parametrize(
    ("source", "changes", "told"),
    [
        ({**RECTANGLE, "irradiance_error": 0}, {}, r"sources\[0\].irradiance_error: must be at least 0.0001"),
        (
            {**RECTANGLE, "irradiance_error": 1e-4, "position": ["0 mm", "0 mm", "1 mm"]},
            {},
            f"more than {MOST_PATCHES}",
        ),
        ({**RECTANGLE, "size": ["10 mm", "nan mm"]}, {}, r"sources\[0\].size\[1\]"),
        ({**RECTANGLE, "least_patches": 5000}, {}, "least_patches: must be at most 4096"),
        ({"type": "surround", "name": "sky", "radiance": "1"}, {}, r"sources\[0\].radiance"),
        (
            {"type": "dome", "name": "d", "diameter": "80 mm", "opening_diameter": "80 mm", **PLACE},
            {},
            "opening_diameter must be smaller",
        ),
        (
            {"type": "area_ring", "name": "a", "diameter": "80 mm", "inner_diameter": "90 mm", **PLACE},
            {},
            "inner_diameter must be smaller",
        ),
        (
            {"type": "disc", "name": "d", "diameter": "8 mm", "least_patches": 9, **PLACE},
            {},
            "goes with irradiance_error",
        ),
        (
            {"type": "surround", "name": "sky", "radiance": "1 W/m^2/sr"},
            {
                "materials.white": {
                    "type": "retroreflective",
                    "model": "perturbed_normal",
                    "reflectance": 0.6,
                    "roughness": 0.02,
                }
            },
            "light from all sides",
        ),
    ],
)
def test_bad_input_is_told(source: dict[str, Any], changes: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        scene(source, **changes)


MIRROR = {"type": "mirror", "reflectance": 0.9}


def test_mirrors_that_throw_wide_light_are_refused() -> None:
    sheet = {**DOCUMENT["targets"][0], "name": "looking_glass", "material": "mirror", "position": PLACE["position"]}
    both = {"materials": {**DOCUMENT["materials"], "mirror": MIRROR}, "targets": [*DOCUMENT["targets"], sheet]}
    with pytest.raises(InputError, match=r"sources\[0\]: the light of \"wide\" that mirrors throw on other targets"):
        scene(RECTANGLE, **both)
    assert scene({**RECTANGLE, "name": "alone"}, **{"materials.white": MIRROR}).emitters


def test_included_files_beside_wide_light(tmp_path: Path) -> None:
    """A wide source is refused; a small one is told to be unchecked."""
    (tmp_path / "inc.rad").write_text("void plastic w 0 0 5 .5 .5 .5 0 0\nw sphere s 0 0 4 0 0 0 10\n")
    included = {"type": "rad", "name": "inc", "rad": "inc.rad", "length_unit": "1 mm"}
    document = {**DOCUMENT, "targets": [included], "sources": [RECTANGLE]}
    with pytest.raises(
        InputError, match=r"sources\[0\]: nobody knows how far \"wide\" is from the surfaces of \"inc\""
    ):
        radwrap.scene_from_document(document, folder=tmp_path)
    disc = {"type": "disc", "name": "disc", "diameter": "80 mm", **PLACE}
    found = radwrap.scene_from_document({**document, "sources": [disc]}, folder=tmp_path)
    assert any('surfaces of "inc" are from it is not known' in line for line in warnings_of(found))


@pytest.mark.parametrize(
    ("other", "crosses"),
    [
        ({"type": "lamp", "position": ["0 mm", "0 mm", "1500 mm"]}, True),
        ({"type": "lamp", "position": ["400 mm", "0 mm", "1500 mm"]}, False),
        ({"type": "lamp", "position": ["0 mm", "0 mm", "600 mm"]}, False),
        ({"type": "lamp", "position": ["60 mm", "0 mm", "1500 mm"]}, True),
        ({"type": "lamp", "position": ["90 mm", "0 mm", "1500 mm"]}, False),
        ({"type": "dome", "position": ["0 mm", "0 mm", "0 mm"]}, True),
        ({"type": "dome", "position": ["0 mm", "0 mm", "0 mm"], "diameter": "800 mm"}, False),
        ({"type": "surround"}, True),
    ],
)
def test_light_that_the_coaxial_disc_would_stop_is_refused(other: dict[str, Any], crosses: bool) -> None:
    """The disc lies at z = 700 mm: from (x, 0, 1500 mm) the sheet, 40 mm wide, is seen through 0.467 x +- 10.7 mm."""
    coaxial = {"type": "coaxial", "name": "coax", "radiance": "10 W/m^2/sr", "diameter": "50 mm", "distance": "200 mm"}
    look = {"look_at": ["0 mm", "0 mm", "0 mm"]}
    level: dict[str, Any] = {"radiance": "1 W/m^2/sr"}
    match other["type"]:
        case "lamp":
            level |= {**look, "diameter": "1 mm", "beam": {"profile": "lambertian"}}
        case "dome":
            up = {"look_at": ["0 mm", "0 mm", "-100 mm"], "diameter": "2 m", "opening_diameter": "80 mm"}
            level |= {**up, "irradiance_error": 0.05}
    document = {**DOCUMENT, "sources": [coaxial, {"name": "other", **level, **other}]}
    if not crosses:
        assert radwrap.scene_from_document(document).emitters
        return
    with pytest.raises(InputError, match=r"sources\[1\]: light of \"other\" may cross the place behind the camera"):
        radwrap.scene_from_document(document)
