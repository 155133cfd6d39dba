"""Pieces of a search for a tolerance: what was finished before a failure is not traced again."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from radwrap.errors import TracerError
from radwrap.imaging.demand import Demand
from radwrap.imaging.methods.pieces import CALL_LOG, packed_levels, unpacked_levels
from radwrap.imaging.optics.view import View
from radwrap.imaging.tolerance.planner import Outcome, render_to_tolerance
from radwrap.imaging.tolerance.replicates import Replicates, Work, noise_beside
from radwrap.process import Programs
from radwrap.progress import Progress
from radwrap.scene.camera import Aperture
from tests.imaging.planes import Array, Planes, view


@dataclass(frozen=True)
class Failing(Planes):
    """Planes whose tracer dies at a call."""

    left: list[int] = field(default_factory=lambda: [10**9])

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        self.left[0] -= 1
        if self.left[0] < 0:
            raise TracerError("died", where="test")
        yield from super().trace(rays)


def stripes(x: Array, y: Array) -> Array:
    """Something with edges."""
    return np.where((x + 0.2 * y) % 4e-3 < 2e-3, 1.0, 0.2)


def search(seen: View, folder: Path, demand: Demand) -> Outcome:
    folder.mkdir(exist_ok=True)
    with Programs() as programs:
        return render_to_tolerance(Work(seen, folder, programs, Progress("", 1, shown=False), "none", 0), demand)


@pytest.mark.parametrize("demand", [Demand(0.3, method="kernel"), Demand(3.0, method="rays")], ids=["kernel", "rays"])
def test_what_is_finished_is_not_traced_again(demand: Demand, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radwrap.imaging.methods.rays._TILE_PIXELS", 256)
    monkeypatch.setattr("radwrap.imaging.methods.kernel._TILE_ROWS", 40)
    base = view(Aperture("round", 2e-4), (1.0, stripes), rows=20)
    planes = ((1.0, stripes),)
    good = search(base, tmp_path / "good", demand)
    log = (tmp_path / "good" / CALL_LOG).read_text().split("\n")
    folder = tmp_path / "broken"
    calls = 1
    while True:  # each run dies one call later than the one before
        tracer = Failing(planes, [calls])
        try:
            outcome = search(View(base.camera, tracer), folder, demand)
            break
        except TracerError:
            calls += 1
        assert calls < 200
    assert outcome.radiance.tobytes() == good.radiance.tobytes()
    assert outcome.certificate == good.certificate
    # Each piece was begun again only while it was not finished, and no other one was begun.
    begun = (folder / CALL_LOG).read_text().split()
    assert set((tmp_path / "good" / CALL_LOG).read_text().split()) == set(begun)
    assert calls > 3 and len(log) > 3
    again = search(base, folder, demand)
    assert again.reused == len(list(folder.glob("piece_*.exr"))) and again.radiance.tobytes() == good.radiance.tobytes()
    assert (folder / CALL_LOG).read_text().split() == begun


def test_a_piece_of_another_plan_is_not_taken(tmp_path: Path) -> None:
    base = view(Aperture("round", 2e-4), (1.0, stripes))
    first = search(base, tmp_path, Demand(2.0, method="kernel"))
    second = search(base, tmp_path, Demand(0.2, method="kernel"))
    assert second.reused == 0 and first.radiance.tobytes() != second.radiance.tobytes()
    for piece in tmp_path.glob("piece_*.exr"):
        piece.write_bytes(piece.read_bytes()[:200])
    third = search(base, tmp_path, Demand(0.2, method="kernel"))
    assert third.reused == 0 and third.radiance.tobytes() == second.radiance.tobytes()


def test_noise_beside_what_rays_correct_is_that_of_the_rest() -> None:
    """Errors of 2 gray everywhere and cells' errors of 3 on a quarter; of the upper half nothing counts."""
    errors = np.full((1, 8, 8), 2.0)
    squares = np.zeros((8, 8), dtype=np.float32)
    squares[4:, :4] = 9.0
    risky = np.zeros((8, 8), dtype=bool)
    risky[:4] = True
    made = Replicates(np.zeros((2, 8, 8), dtype=np.float32), squares, rays=0, reused=0, block=(1, 1))
    assert noise_beside(made, errors, risky) == pytest.approx(4 / 2 + 9 / 4)
    assert noise_beside(made, errors, ~risky) == pytest.approx(4 / 2)


@pytest.mark.parametrize("columns", [1, 4, 7])
def test_levels_of_cells_come_back_from_their_pieces(columns: int) -> None:
    levels = np.random.default_rng(1).integers(0, 16, (50, columns), dtype=np.int8)
    packed = packed_levels(levels)
    assert packed.dtype == np.float32 and packed.shape == (50, -(-columns // 4))
    found = unpacked_levels(packed, columns)
    assert found.dtype == np.int8 and np.array_equal(found, levels)
    with pytest.raises(ValueError, match="0 to 15"):
        packed_levels(np.full((1, columns), 16, dtype=np.int8))
