"""The catalog of materials: every value says where it comes from, and what nobody measured is said to be assumed."""

from __future__ import annotations

import re
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from radwrap.errors import InputError
from radwrap.scene.catalog.places import listed
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.materials import Anisotropic, Glass, Specular
from radwrap.scene.scene import Scene

NAMES = sorted(name for name, _, _ in listed("materials"))
CITED = set(re.findall(r"^@\w+\{([\w-]+),", Path("CITATIONS.bib").read_text(), re.MULTILINE))


def told(name: str) -> dict[str, Any]:
    return tomllib.loads((files("radwrap") / "data" / "materials" / f"{name}.toml").read_text("utf-8"))


def scene_with(**material: Any) -> Scene:
    tables = tomllib.loads((files("radwrap") / "data" / "init" / "scene.toml").read_text("utf-8"))
    tables["materials"]["one"] = material
    tables["targets"].append({"type": "sheet", "material": "one", "size": ["1 mm", "1 mm"]})
    return scene_from_document(tables)


@pytest.mark.parametrize("name", NAMES)
def test_each_value_has_a_source_or_is_assumed(name: str) -> None:
    table = told(name)
    catalog = table.pop("catalog")
    kind = table.pop("type")
    assert catalog["format"] == 1
    assert {"name", "revision", "finish", "wavelength", "spread", "conversion"} <= set(catalog)
    assert set(catalog["from"]) == set(table)
    bases = {key: entry["basis"] for key, entry in catalog["from"].items()}
    for entry in catalog["from"].values():
        assert entry["basis"] in ("measured", "derived", "assumed")
        if entry["basis"] == "measured":
            assert catalog["sources"][entry["source"]]["citation"] in CITED
    scene = scene_with(type=kind, preset=name)
    assumed = {key for key in scene.assumed if key.startswith("materials.one.")}
    assert assumed == {f"materials.one.{key}" for key, basis in bases.items() if basis == "assumed"}


def test_most_of_them_were_measured() -> None:
    measured = [name for name in NAMES if all(e["basis"] != "assumed" for e in told(name)["catalog"]["from"].values())]
    assert len(NAMES) == 14 and len(measured) == 11


def test_values_are_those_of_the_source() -> None:
    assert scene_with(type="specular", preset="rolled_brass").materials["one"] == Anisotropic(0.10, 0.33, 0.05, 0.16)
    assert scene_with(type="specular", preset="white_ceramic_tile").materials["one"] == Specular(0.70, 0.05, 0.071)


def test_glass_loses_what_both_faces_reflect() -> None:
    pane = scene_with(type="glass", preset="clear_glass").materials["one"]
    assert isinstance(pane, Glass)
    lost = ((pane.refractive_index - 1) / (pane.refractive_index + 1)) ** 2
    assert pane.transmittance == pytest.approx((1 - lost) / (1 + lost), abs=6e-4)
    assert pane.refractive_index == pytest.approx(1.51509, abs=1e-3)


def test_what_is_given_beside_a_preset_counts() -> None:
    scene = scene_with(type="specular", preset="polished_steel", roughness=0.1)
    assert scene.materials["one"] == Specular(0.02, 0.55, 0.1)
    assert "materials.one.roughness" not in scene.assumed and "materials.one.specular_reflectance" in scene.assumed


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"type": "specular", "preset": "roled_brass"}, 'did you mean "rolled_brass"?'),
        ({"type": "specular", "preset": "clear_glass"}, 'is a material of type "glass"'),
        ({"type": "lambertian", "preset": "rolled_brass"}, "unknown key"),
        ({"type": "specular", "preset": 3}, "is not a name of the catalog"),
    ],
)
def test_presets_that_there_are_not_are_refused(material: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        scene_with(**material)
    assert message in str(refused.value) and "materials.one" in str(refused.value)
