"""Our emulated chips against a host that others wrote."""

from __future__ import annotations

import sys

import pytest

from tests.led.benches import FakeBench
from tests.led.conformance import FIRST, light
from tests.led.independent_host import drive_by_easymcp2221


def test_easymcp2221_drives_our_emulator(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = FakeBench("mcp2221a_pca9685")
    monkeypatch.setitem(sys.modules, "hid", bench.module)  # type: ignore[arg-type]
    for name in [name for name in sys.modules if name.startswith("EasyMCP2221")]:
        monkeypatch.delitem(sys.modules, name)
    drive_by_easymcp2221(FIRST, lambda: light(bench))
