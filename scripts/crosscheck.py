"""All scenes of rad_scenes/crosscheck by Radiance and by POV-Ray: prints the table of `make crosscheck`."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "rad_scenes" / "crosscheck"
OUT = ROOT / "out" / "crosscheck"
# What a scene needs beside the defaults.
OPTIONS = {
    "corner_cubes": ["--pixel-samples", "4"],
    "mirror": ["--pixel-samples", "4"],
    "edge_far": ["--viewpoints", "37", "--pixel-samples", "3"],
    "edge_near": ["--viewpoints", "37", "--pixel-samples", "3"],
    "everything": ["--viewpoints", "19", "--pixel-samples", "1"],
    "extended_source": ["--area-samples", "9"],
}


def main() -> int:
    """Run every scene, then print one line each; 1 where one differs, 4 where one fails."""
    scenes = sorted(path.parent for path in SCENES.glob("*/scene.toml"))
    print(
        f"{'scene':16} {'rms/peak':>9} {'max/peak':>9} {'gray rms':>8} {'gray max':>8}  {'worst term':10}", flush=True
    )
    code = 0
    for scene in scenes:
        start = time.monotonic()
        out = OUT / scene.name
        argv = [sys.executable, "-m", "radwrap.cli.main", "crosscheck", str(scene / "scene.toml"), "--out", str(out)]
        done = subprocess.run([*argv, "--json", *OPTIONS.get(scene.name, [])], capture_output=True, check=False)
        if done.returncode not in (0, 1):
            print(f"{scene.name:16} failed: {done.stderr.decode().strip().splitlines()[-1]}")
            code = 4
            continue
        print(f"{scene.name:16} {_row(json.loads(done.stdout))}  {time.monotonic() - start:.1f} s", flush=True)
        code = max(code, done.returncode)
    return code


def _row(found: dict) -> str:  # type: ignore[type-arg]
    name, worst = max(found["terms"].items(), key=lambda item: item[1]["measured"])
    whole, gray = found["radiance"], found["gray"]
    return (
        f"{whole['rms_of_peak']:9.3%} {whole['maximum_of_peak']:9.3%} {gray['rms']:8.4f} {gray['maximum']:8.4f}  "
        f"{name:10} {worst['measured']:.3%} {worst['verdict']}"
    )


if __name__ == "__main__":
    sys.exit(main())
