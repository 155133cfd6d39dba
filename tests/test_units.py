"""The grammar of quantities: one finite number, one blank, one unit."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from radwrap.errors import InputError
from radwrap.units import (
    ANGLE,
    COEFFICIENT_OF_RETROREFLECTION,
    LENGTH,
    PIXEL,
    RADIANCE,
    RADIANT_INTENSITY,
    TIME,
    Dimension,
    parse_gain,
    parse_quantity,
)

ALL = [LENGTH, ANGLE, TIME, RADIANCE, RADIANT_INTENSITY, COEFFICIENT_OF_RETROREFLECTION, PIXEL]


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("12.5 mm", LENGTH, 0.0125),
        ("-3 um", LENGTH, -3e-6),
        ("1e-3 m", LENGTH, 1e-3),
        (".5 in", LENGTH, 0.0127),
        ("2. ft", LENGTH, 0.6096),
        ("+90 deg", ANGLE, math.pi / 2),
        ("60 arcmin", ANGLE, math.pi / 180),
        ("3600 arcsec", ANGLE, math.pi / 180),
        ("130 ms", TIME, 0.13),
        ("47.1 mW/sr", RADIANT_INTENSITY, 0.0471),
        ("2324 W/m^2/sr", RADIANCE, 2324.0),
        ("1 mW/mm^2/sr", RADIANCE, 1000.0),
        ("95 cd/lx/m^2", COEFFICIENT_OF_RETROREFLECTION, 95.0),
        ("95.5 px", PIXEL, 95.5),
    ],
)
def test_quantities_become_si(text: str, dimension: Dimension, value: float) -> None:
    assert parse_quantity(text, dimension) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        "12,5 mm", "12 5 mm", "12.5mm", "12.5  mm", " 12.5 mm", "12.5 mm ", "12.5\tmm", "12.5\u00a0mm", "12.5 mm; 3",
        "nan mm", "inf mm", "-inf mm", "1e999 mm", "1e-999 mm", "mm", "12.5", "", "0x10 mm", "1_000 mm",
        "\uff11\uff12 mm", "12.5 MM", "12.5 deg", "12.5 W/sr", "12.5 mm^2", "1e mm", "--1 mm", "1.2.3 mm",
        12.5, None, True, ["1 mm"],
    ],
)  # fmt: skip
def test_everything_else_is_refused(text: object) -> None:
    with pytest.raises(InputError):
        parse_quantity(text, LENGTH)


def test_steradian_counts() -> None:
    with pytest.raises(InputError, match="not a unit of radiant intensity"):
        parse_quantity("47.1 mW", RADIANT_INTENSITY)
    with pytest.raises(InputError, match="not a unit of radiance"):
        parse_quantity("47.1 W/m^2", RADIANCE)


@pytest.mark.parametrize("text", ["1" * 400, f"{'1' * 400} fathom", "m" * 400])
def test_a_long_text_is_quoted_by_its_beginning(text: str) -> None:
    for read in (lambda: parse_quantity(text, LENGTH), lambda: parse_gain(text)):
        with pytest.raises(InputError) as caught:
            read()
        assert len(str(caught.value)) < 200


def test_the_message_names_the_units() -> None:
    with pytest.raises(InputError, match="km, in, ft"):
        parse_quantity(12.5, LENGTH)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e200, max_value=1e200), st.sampled_from(ALL))
def test_any_number_comes_back(value: float, dimension: Dimension) -> None:
    for unit, size in dimension.units.items():
        if value != 0 and abs(value * size) < 1e-300:
            continue
        assert parse_quantity(f"{value!r} {unit}", dimension) == pytest.approx(value * size, rel=1e-15)


@given(st.text(max_size=20))
def test_no_text_but_the_grammar_passes(text: str) -> None:
    import re

    try:
        parse_quantity(text, LENGTH)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert re.fullmatch(LENGTH.pattern, text)


def test_the_gain_carries_gamma() -> None:
    assert parse_gain("3.38e4 (J/m^2)^-0.85") == (3.38e4, 0.85)
    for wrong in ("3.38e4", "3.38e4 (J/m^2)^0.85", "3.38e4 (J/m2)^-0.85", 3.38e4, "nan (J/m^2)^-0.85"):
        with pytest.raises(InputError):
            parse_gain(wrong)
