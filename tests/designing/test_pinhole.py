"""The pinhole of the sharpest edge, with diffraction: the search's answer against a fine sweep of the same scene."""

from __future__ import annotations

from pathlib import Path

import pytest

from radwrap.designing.document import read_problem
from radwrap.designing.quantities import is_tie
from radwrap.designing.run import run_design
from radwrap.designing.told import Designed
from radwrap.study.study import StudyOptions

SCENE = Path(__file__).parents[2] / "rad_scenes" / "design_edge" / "scene.toml"
TEXT = """
scene = "{scene}"
budget = {budget}
coarse = {coarse}
batch = 4
seed = {seed}
[set]
"camera.exposure_time" = "60 ms"
"camera.sensor.rows" = 24
"camera.sensor.columns" = 36
[render]
tolerance = 0.5
[keys.pinhole]
key = "camera.aperture.diameter"
low = "0.09 mm"
high = "0.19 mm"
{step}
[responses.blur]
measure = "edge_blur"
dark = "sensor"
gamma = "sensor"
[[objectives]]
of = "blur"
aim = "minimise"
"""


def designed(folder: Path, name: str, **how: object) -> Designed:
    path = folder / f"{name}.toml"
    path.write_text(TEXT.format(scene=SCENE, **how))
    return run_design(read_problem(path), folder / name, StudyOptions(workers=1))


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
def test_the_best_pinhole_is_that_of_a_fine_sweep(tmp_path: Path) -> None:
    sweep = designed(tmp_path, "sweep", budget=23, coarse=1, seed=5, step='step = "0.005 mm"')
    found = designed(tmp_path, "found", budget=20, coarse=2, seed=6, step="")
    assert sweep.best is not None and found.best is not None
    best, own = (one.best.answers["blur"] for one in (sweep, found) if one.best is not None)
    assert is_tie(best, own) or own.value < best.value
    # Its pinhole lies among those of the sweep that errors do not tell from the best one, or a step beside them.
    size = float(str(found.best.values["camera.aperture.diameter"]).split()[0])
    ties = [float(one.values["camera.aperture.diameter"].split()[0]) for one in (sweep.best, *sweep.ties)]
    assert min(ties) - 0.005 <= size <= max(ties) + 0.005
    assert min(ties) > 0.095 and max(ties) < 0.185  # the optimum lies within, as both ends are worse
