"""The conformance cases on the benches that need no kernel; `make test-hid` runs them in virtual machines."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from radwrap.led.backend import Kind
from tests.led.benches import EmulatorBench, FakeBench
from tests.led.conformance import CASES, Bench

KINDS: tuple[Kind, ...] = ("mcp2221a_pca9685", "lamparray")


@pytest.fixture(scope="module", params=KINDS)
def emulators(request: pytest.FixtureRequest) -> Iterator[EmulatorBench]:
    bench = EmulatorBench(request.param)
    yield bench
    bench.close()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_on_a_fake_of_hidapi(kind: Kind, case: Callable[[Bench], None]) -> None:
    case(FakeBench(kind))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_on_an_emulator_in_its_own_process(emulators: EmulatorBench, case: Callable[[Bench], None]) -> None:
    case(emulators)
