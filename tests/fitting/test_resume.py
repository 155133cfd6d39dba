"""A fit that is killed goes on with what was traced, and ends as it would have."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.fitting import fit as fitting
from radwrap.fitting import light
from radwrap.scene.scene import Scene
from tests.fitting.conftest import LEVELS

COARSE = radwrap.RenderOptions(tolerance=8.0, workers=1)  # what is traced again hangs on no accuracy
FIRST = 1  # images of a fit: one by few rays, that says who traces, and one of each source


def _stamps(out: Path) -> dict[str, tuple[int, int]]:
    found = sorted((out / ".fit").glob("*/manifest.json")) + sorted((out / ".fit").glob("*/source_images.npz"))
    return {str(path.relative_to(out)): (path.stat().st_ino, path.stat().st_mtime_ns) for path in found}


@pytest.mark.parametrize(
    ("stage", "bases"),
    [pytest.param((light, "source_images"), FIRST, marks=pytest.mark.long), ((fitting, "write_fit"), 2)],
)
def test_a_killed_fit_traces_nothing_twice(
    bench: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stage: tuple[Any, str], bases: int
) -> None:
    """Killed once so many images were traced."""
    capture = radwrap.render(bench, options=COARSE, seed=5).frames(1)

    def fitted(out: Path) -> radwrap.Fit:
        return radwrap.fit(bench, capture, [LEVELS], out, COARSE)

    fitted(tmp_path / "good")
    assert not (tmp_path / "good" / ".fit").exists()

    def killed(*_: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(*stage, killed)
        with pytest.raises(KeyboardInterrupt):
            fitted(tmp_path / "out")
    assert not (tmp_path / "out" / "fit.json").exists()
    before, after = _stamps(tmp_path / "out"), {}
    looked, look = [], light.write_pilot

    def counted(*given: Any) -> None:
        looked.append(given)
        look(*given)

    monkeypatch.setattr(light, "write_pilot", counted)
    assert len(before) == bases
    write = fitting.write_fit

    def written(made: radwrap.Fit, text: str, out: Path) -> None:
        after.update(_stamps(out))
        write(made, text, out)

    monkeypatch.setattr(fitting, "write_fit", written)
    fitted(tmp_path / "out")
    assert {name: after[name] for name in before} == before and len(after) == 2
    assert not looked  # what an image needs is known
    told = [json.loads((tmp_path / name / "fit.json").read_text()) for name in ("good", "out")]
    assert told[0] == told[1]
    assert not (tmp_path / "out" / ".fit").exists()
