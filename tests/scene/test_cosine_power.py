"""Beams cos^n: what a width means, and that Radiance gives what the formula says (tests/study holds POV-Ray to it)."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.scene.look.probes import LIT_SHARE, beam_reach
from radwrap.scene.sources import Beam, WidthDefinition, cosine_power_spread

SCENE = Path(__file__).parents[2] / "rad_scenes" / "crosscheck" / "cosine_beam" / "scene.toml"


@pytest.mark.parametrize(
    ("definition", "angle", "share"),
    [("fwhm", 0.2, 0.5), ("half_angle", 0.4, 0.5), ("1/e^2_full", 0.2, math.exp(-2)), ("sigma", None, None)],
)
def test_widths(definition: WidthDefinition, angle: float | None, share: float | None) -> None:
    beam = Beam("cosine_power", cosine_power_spread(0.4, definition))
    if angle is None:
        assert beam.spread == 0.4
    else:
        assert beam.relative_intensity(np.array([angle]))[0] == pytest.approx(share, rel=1e-12)
    assert beam.relative_intensity(np.array([0.0, math.pi / 2, 3.0])).tolist() == pytest.approx([1.0, 0.0, 0.0])
    assert beam.relative_intensity(np.array([beam_reach(beam)]))[0] == pytest.approx(LIT_SHARE, rel=1e-9)


def test_it_meets_the_gaussian_on_the_axis() -> None:
    """ln cos(theta)/s^2 is -theta^2/(2 s^2) - theta^4/(12 s^2) - ..."""
    spread, theta = 0.05, np.linspace(0, 0.2, 101)
    ratio = Beam("cosine_power", spread).relative_intensity(theta) / Beam("gaussian", spread).relative_intensity(theta)
    assert np.log(ratio) == pytest.approx(-(theta**4) / (12 * spread**2), abs=3e-3)


@pytest.mark.parametrize(
    "beam", [{"width": "180 deg"}, {"width": "90 deg", "width_definition": "half_angle"}, {}, {"width": "-1 deg"}]
)
def test_widths_that_no_power_has_are_refused(beam: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"sources\[0\]\.beam"):
        radwrap.load_scene(SCENE, {"sources[0].beam": {"profile": "cosine_power", **beam}})
