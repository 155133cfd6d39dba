"""Renders one image by Mitsuba 3: a process of its own, with no word of radwrap in it.

    python mitsuba_process.py SCENE.json IMAGE.npy REPORT.json SAMPLES SEED VARIANT

Each pixel gets SAMPLES samples, in passes where the arrays would get too large.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

_RAYS_AT_ONCE: Final = 1 << 24


def main(arguments: list[str]) -> int:
    """Load, render, write."""
    scene_file, image_file, report_file = map(Path, arguments[:3])
    samples, seed = int(arguments[3]), int(arguments[4])
    start = time.perf_counter()
    import mitsuba

    mitsuba.set_variant(arguments[5])
    scene = mitsuba.load_dict(_matrices(json.loads(scene_file.read_text()), mitsuba.ScalarTransform4f))
    loaded = time.perf_counter()
    width, height = scene.sensors()[0].film().size()
    at_once = max(1, min(samples, _RAYS_AT_ONCE // (width * height)))
    total = np.zeros((height, width))
    done = 0
    while done < samples:
        now = min(at_once, samples - done)
        image = mitsuba.render(scene, spp=now, seed=seed + done)
        total += now * np.asarray(image, dtype=np.float64).reshape(height, width, -1)[..., 0]
        done += now
    rendered = time.perf_counter()
    np.save(image_file, (total / samples).astype(np.float32))
    report = {"version": mitsuba.__version__, "load_s": loaded - start, "render_s": rendered - loaded}
    report_file.write_text(json.dumps(report))
    return 0


def _matrices(value: Any, matrix: Any) -> Any:
    """The description with its matrices in Mitsuba's type."""
    if not isinstance(value, dict):
        return value
    return {key: matrix(item) if key == "to_world" else _matrices(item, matrix) for key, item in value.items()}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
