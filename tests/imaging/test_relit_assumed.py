"""What a relit image hangs on: each source's assumed level against the image of that level."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.cli.main import main
from radwrap.errors import InputError
from radwrap.imaging.response.sensor import gray_levels
from radwrap.scene.file.load import scene_from_document, with_changes
from tests.imaging.three_rings import three_rings

SCENE: dict[str, Any] = three_rings(10, 12, "200 ms")


def test_each_assumed_level_moves_a_relit_image_by_its_own_light(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scene_from_document(SCENE)
    lit, out = tmp_path / "lit", tmp_path / "out"
    radwrap.render(scene, lit, tolerance=40, basis=True)
    words = [str(lit), "--level", "left=0.4", "--level", "far=0.2", "--set", "camera.sensor.offset=100"]
    assert main(["relight", *words, "--out", str(out)]) == 0
    (image,) = json.loads((out / "relight.json").read_text())["images"].values()
    effects = {one["key"]: one for one in image["assumed_effects"]}
    levels = {"left": 0.4, "far": 0.2}
    changes = {"camera.sensor.offset": 100}

    def mean(changed: dict[str, float]) -> float:
        exposure = radwrap.relight(lit, levels | changed, changes).radiant_exposure.values
        return float(gray_levels(exposure, sensor).mean())

    sensor = radwrap.with_value(scene, "camera.sensor.offset", 100).camera.sensor
    for number, name in ((0, "left"), (2, "far")):
        ends = [mean({name: levels[name] * factor}) - mean({}) for factor in (0.1, 10)]
        assert ends[0] < -1 < 10 < ends[1]
        assert effects[f"sources[{number}].radiant_intensity"]["mean_gray"] == pytest.approx(ends, rel=1e-4)
    assert "sources[1].radiant_intensity" not in effects, "the user said it"
    assert "camera.sensor.offset" not in effects and "camera.sensor.prnu" in effects


def test_what_is_not_known_any_more_is_not_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The component of the scene's folder is not that of the package, which is all that is seen from elsewhere."""
    lit, out = tmp_path / "lit", tmp_path / "out"
    (tmp_path / "catalog" / "lights").mkdir(parents=True)
    package = Path(radwrap.__file__).parent / "data" / "lights" / "generic_ring_60mm_16led.toml"
    own = tmp_path / "catalog" / "lights" / package.name
    own.write_text(package.read_text().replace("[0.1, 10]", "[0.5, 2]"))
    monkeypatch.setenv("RADWRAP_CATALOG", str(tmp_path / "catalog"))
    radwrap.render(scene_from_document(SCENE), lit, tolerance=40, basis=True)
    monkeypatch.delenv("RADWRAP_CATALOG")
    assert main(["relight", str(lit), "--out", str(out)]) == 0
    (image,) = json.loads((out / "relight.json").read_text())["images"].values()
    assert "assumed_effects" not in image


@pytest.mark.long  # without spectra the same is seen in test_turned_basis
def test_what_comes_after_the_electrons_may_change_under_spectra(tmp_path: Path) -> None:
    """As a fresh scene has it: none of these keys weighs light of another wavelength otherwise."""
    sources = [one | {"spectrum": {"line": "630 nm", "width": "20 nm"}} for one in SCENE["sources"][:1]]
    scene = scene_from_document(SCENE | {"sources": sources})
    radwrap.render(scene, tmp_path / "lit", tolerance=40, basis=True)
    changes = {"camera.sensor.offset": 100, "camera.sensor.system_gain": "0.002 DN/e"}
    exposure = radwrap.relight(tmp_path / "lit").radiant_exposure.values
    other = with_changes(scene, changes).camera.sensor
    made = radwrap.relight(tmp_path / "lit", {}, changes)
    assert made.gray.values == pytest.approx(np.rint(gray_levels(exposure, other)), abs=1e-9)
    assert np.ptp(made.gray.values) > 10
    with pytest.raises(InputError, match="may weigh the scene's spectra"):
        radwrap.relight(tmp_path / "lit", {}, {"camera.sensor.wavelength": "620 nm"})
