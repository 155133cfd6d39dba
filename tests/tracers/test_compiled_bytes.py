"""The same bytes, however rays are cut into blocks, on however many threads, and whatever the processor."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from radwrap.tracers.bouncing import SURE_STEPS
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.walker import WalkingTracer
from radwrap.tracers.text_frame import traced_frame
from tests.tracers.crowd import crowd, rays_at

ROOT = Path(__file__).parents[2]
RAYS = 3000
# All kernels from nothing, on a machine with other work.
LIMIT_S = 600.0


@pytest.fixture(scope="module")
def tracer() -> CompiledTracer:
    scene = crowd(4)
    return CompiledTracer(compiled_scene(scene, traced_frame(scene)))


def answers(tracer: CompiledTracer, rays: np.ndarray) -> bytes:
    ((values, distances),) = tracer.trace_with_distances([rays])
    ((_, _, normals),) = tracer.surfaces([rays])
    (parts,) = tracer.parts([rays])
    (walked,) = walks(tracer).trace([rays])
    return b"".join(array.tobytes() for array in (values, distances, normals, parts, walked))


def walks(tracer: CompiledTracer) -> WalkingTracer:
    """Walks over surfaces that reflect as diffuse and glossy ones do, whatever they are in direct light."""
    covers = np.arange(len(tracer.scene.part_of_cover))
    reflecting = np.column_stack([0.2 + 0.1 * (covers % 3), 0.3 * (covers % 2), 0.05 + 0.1 * (covers % 2)])
    return WalkingTracer(tracer, reflecting, None, SURE_STEPS)


@pytest.mark.parametrize("size", [1, 7, 1000, 2999])
def test_blocks_change_nothing(size: int, tracer: CompiledTracer) -> None:
    rays = rays_at(crowd(4), RAYS, 1)
    blocks = [rays[start : start + size] for start in range(0, RAYS, size)]
    pieces = list(tracer.trace_with_distances(blocks))
    ((values, distances),) = tracer.trace_with_distances([rays])
    assert np.concatenate([value for value, _ in pieces]).tobytes() == values.tobytes()
    assert np.concatenate([distance for _, distance in pieces]).tobytes() == distances.tobytes()
    assert np.concatenate(list(tracer.parts(blocks))).tobytes() == next(tracer.parts([rays])).tobytes()


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.long), 7])
def test_threads_change_nothing(threads: int, tracer: CompiledTracer) -> None:
    rays = rays_at(crowd(4), RAYS, 2)
    blocks = np.array_split(rays, 29)
    expected = [answers(tracer, block) for block in blocks]
    with ThreadPoolExecutor(threads) as pool:
        assert list(pool.map(lambda block: answers(tracer, block), blocks)) == expected


def digest() -> str:
    """Of a crowd's answers, for other processes."""
    scene = crowd(4)
    tracer = CompiledTracer(compiled_scene(scene, traced_frame(scene)))
    return hashlib.sha256(answers(tracer, rays_at(scene, RAYS, 1))).hexdigest()


def digest_elsewhere(cache: Path, settings: Mapping[str, str]) -> str:
    """The same by a process with other settings, which keeps what it compiles in a folder of its own."""
    code = "from tests.tracers.test_compiled_bytes import digest; print(digest())"
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(ROOT / "scripts"), **settings}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.long
def test_any_processor_gives_the_same_bytes(tmp_path: Path) -> None:
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    assert digest_elsewhere(tmp_path, plain) == digest()


@pytest.mark.long
def test_no_place_outside_an_array_is_read(tmp_path: Path) -> None:
    assert digest_elsewhere(tmp_path, {"NUMBA_BOUNDSCHECK": "1"}) == digest()


@pytest.mark.long
def test_two_processes_may_compile_at_once(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        both = set(pool.map(lambda _: digest_elsewhere(tmp_path, {}), range(2)))
    assert both == {digest()}
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb*")}
    # A third one finds all that it needs, whole.
    assert digest_elsewhere(tmp_path, {}) in both
    assert kept == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb*")}
    assert any(path.name.startswith("kernels.trace") for path in kept)


@pytest.mark.long
def test_without_a_place_for_what_is_compiled(tmp_path: Path) -> None:
    """Its folder cannot be made, where a file stands in its way: each process compiles for itself."""
    (tmp_path / "file").touch()
    settings = {"HOME": str(tmp_path / "file"), "XDG_CACHE_HOME": str(tmp_path / "file")}
    assert digest_elsewhere(tmp_path, settings) == digest()
