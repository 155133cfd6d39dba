"""The four captures of rad_scenes/twin: a scene whose values are known, as its camera would see it.

    .venv/bin/python scripts/twin_captures.py [--out FOLDER]

Images are made by rays to a third of a gray level rms, half of what noise and rounding are, with a seed that no fit
takes; then noise is drawn and levels are rounded. The values stand in `TRUTH`. Twelve minutes of processor time.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

import radwrap
from radwrap.fitting.free_keys import free_scene
from radwrap.fitting.series import read_series
from radwrap.images import write_png

FOLDER: Final = Path(__file__).resolve().parent.parent / "rad_scenes" / "twin"
LEVELS: Final = "sources[0].leds[*].radiance_factor"
POSE: Final = "pose:board"
GAMMA: Final = "camera.sensor.gamma"
FREE: Final = (LEVELS, POSE, f"{GAMMA}=0.5:1.5")
# Factors of six LEDs; the board's shift [mm] and turn [deg] about its pose; the look-up table's exponent.
TRUTH: Final = (1.15, 0.8, 1.0, 1.3, 0.7, 0.95, 1.0, -0.6, 4.0, 0.8, -0.5, 1.0, 0.8)
TOLERANCE: Final = 0.35  # gray level rms
SEED: Final = 77_000


def captures(folder: Path) -> list[Path]:
    """Make them."""
    scene = radwrap.load_scene(FOLDER / "scene.toml")
    written: dict[str, Any] = free_scene(scene, FREE).written(TRUTH)
    made = []
    for number, state in enumerate(read_series(FOLDER / "captures.toml")):
        there = radwrap.load_scene(FOLDER / "scene.toml", {**written, **state.changes})
        options = radwrap.RenderOptions(method="rays", tolerance=TOLERANCE, seed=SEED + number, tracer="compiled")
        image = radwrap.render(there, options=options).frames(1, seed=SEED + number)[0]
        made.append(folder / Path(str(state.images[0])).name)
        write_png(made[-1], image.codes)
    return made


def main() -> None:
    """Write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder (default: rad_scenes/twin)")
    for path in captures(parser.parse_args().out):
        print(f"wrote {path.name}", file=sys.stderr)


if __name__ == "__main__":
    main()
