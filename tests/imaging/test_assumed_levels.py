"""What an image in the light of several sources hangs on: each assumed level moves it by its own light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.file.load import scene_from_document
from tests.imaging.three_rings import three_rings

LEVEL = 50.0  # of an LED of these rings [mW sr^-1]
SCENE: dict[str, Any] = three_rings(16, 20, "900 ms", count=2)
# Casts the left ring's shadow over half of what is seen: shares without shadows are others.
SCENE["targets"].append(
    {
        **{"type": "sheet", "name": "screen", "material": "grey", "size": ["60 mm", "60 mm"]},
        "position": ["-45 mm", "0 mm", "150 mm"],
    }
)


def rendered(document: dict[str, Any], out: Path, **options: Any) -> radwrap.Rendered:
    return radwrap.render(scene_from_document(document), out, tolerance=20, seed=3, **options)


def effects_in(run: radwrap.Rendered) -> dict[str, tuple[float, float]]:
    return {one["key"]: tuple(one["mean_gray"]) for one in run.manifest.get("assumed_effects", ())}


def mean_with(document: dict[str, Any], number: int, factor: float, out: Path) -> float:
    """Mean gray level of a render with another level of one source."""
    sources = [dict(one) for one in document["sources"]]
    sources[number]["radiant_intensity"] = f"{LEVEL * factor:.9g} mW/sr"
    made = rendered(document | {"sources": sources}, out)
    return float(gray_levels(made.radiant_exposure.values, made.scene.camera.sensor).mean())


@pytest.mark.long
def test_each_level_of_several_moves_a_render_by_its_own_light(tmp_path: Path) -> None:
    """Against renders with that level at the ends of its range; their rays are others than the shares'."""
    effects = effects_in(run := rendered(SCENE, tmp_path / "run"))
    before = float(gray_levels(run.radiant_exposure.values, run.scene.camera.sensor).mean())
    for number in (0,):  # in part hidden
        ends = effects[f"sources[{number}].radiant_intensity"]
        truth = [mean_with(SCENE, number, factor, tmp_path / f"{number}_{factor}") - before for factor in (0.1, 10)]
        assert truth[0] < -2 < 20 < truth[1]
        assert ends == pytest.approx(truth, rel=0.03)
    assert "sources[1].radiant_intensity" not in effects, "the user said it"


def test_a_dark_source_has_no_share(tmp_path: Path) -> None:
    """All light is the left ring's: its level moves the mean like the whole image's."""
    left, right, _ = SCENE["sources"]
    run = rendered(SCENE | {"sources": [left, right | {"radiant_intensity": "0 mW/sr"}]}, tmp_path / "run")
    sensor = run.scene.camera.sensor
    before, tenth = (float(gray_levels(factor * run.radiant_exposure.values, sensor).mean()) for factor in (1.0, 0.1))
    assert effects_in(run)["sources[0].radiant_intensity"][0] == pytest.approx(tenth - before, rel=1e-6)
