"""Wide and measured sources in the light basis and in the cross-check: one column each, or a refusal by name."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.forecast.explain import explain
from radwrap.imaging.relight.relit import read_basis, relit
from radwrap.tracers.povray_text import povray_scene
from radwrap.tracers.text_frame import users_frame
from tests.cli.conftest import scene_with

LINEAR: Final = 1e-5  # sums of float32, as in test_basis
PLACE: Final = {"look_at": ["0 mm", "0 mm", "0 mm"]}
RECTANGLE: Final[dict[str, Any]] = {
    "type": "rectangle",
    "name": "bar",
    "position": ["0 mm", "60 mm", "120 mm"],
    "size": ["100 mm", "10 mm"],
    "radiance": "300 W/m^2/sr",
    **PLACE,
}
DISC: Final = {
    "type": "disc",
    "name": "disc",
    "diameter": "60 mm",
    "position": ["0 mm", "-90 mm", "150 mm"],
    "radiance": "100 W/m^2/sr",
    "irradiance_error": 0.02,
    **PLACE,
}
LAMP: Final = "IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0\n1 1 50\n0 90\n0\n100 100\n"


def test_a_wide_source_is_one_column(tmp_path: Path) -> None:
    scene = radwrap.scene_from_document(scene_with({"sources": [RECTANGLE, DISC]}))
    assert len(scene.emitters) > 10
    whole = radwrap.render(scene, tmp_path, method="kernel", tolerance=4.0, basis=True)
    basis = read_basis(tmp_path)
    assert basis.sources == ("bar", "disc")
    (both,) = relit(basis, [[1, 1]])
    exposure = whole.radiant_exposure.values
    assert np.abs(both.radiant_exposure.values - exposure).max() <= LINEAR * exposure.max()


def test_explain_and_povray_know_them(tmp_path: Path) -> None:
    scene = radwrap.scene_from_document(scene_with({"sources": [RECTANGLE, DISC]}))
    told = explain(scene)["wide_sources"]
    assert [wide["name"] for wide in told] == ["bar", "disc"]
    assert all(wide["irradiance_error"] <= wide["irradiance_error_asked"] for wide in told)
    text = povray_scene(scene, {}, users_frame(scene))
    assert text.count("light_source") == sum(wide["patches"] for wide in told) == text.count("mesh2")
    (tmp_path / "lamp.ies").write_text(LAMP)
    lamp = {"type": "ies", "name": "lamp", "file": "lamp.ies", "position": ["0 mm", "0 mm", "300 mm"], **PLACE}
    luminaire = radwrap.scene_from_document(scene_with({"sources": [lamp]}), folder=tmp_path)
    with pytest.raises(InputError, match="POV-Ray has no luminaire"):
        povray_scene(luminaire, {}, users_frame(luminaire))
