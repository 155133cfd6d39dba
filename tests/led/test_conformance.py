"""The conformance cases on the benches that need no kernel; `make test-hid` runs them in virtual machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from radwrap.led.backend import Kind
from tests.led.benches import EmulatorBench, FakeBench
from tests.led.conformance import CASES, Bench, cases_for

KINDS: tuple[Kind, ...] = ("mcp2221a_pca9685", "lamparray")


FAKES = {kind: FakeBench(kind) for kind in KINDS}


@pytest.fixture(scope="module", params=KINDS)
def emulators(request: pytest.FixtureRequest) -> Iterator[EmulatorBench]:
    bench = EmulatorBench(request.param)
    yield bench
    bench.close()


@pytest.mark.parametrize(
    ("kind", "case"),
    [(kind, case) for kind in KINDS for case in cases_for(FAKES[kind])],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_on_a_fake_of_hidapi(kind: Kind, case: Callable[[Bench], None]) -> None:
    case(FakeBench(kind))


@pytest.mark.parametrize("number", range(len(CASES)), ids=[case.__name__ for case in CASES])
def test_on_an_emulator_in_its_own_process(emulators: EmulatorBench, number: int) -> None:
    if CASES[number] in cases_for(emulators):
        CASES[number](emulators)
