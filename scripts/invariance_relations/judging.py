"""Both images of a relation, and what chance would allow between them."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import binom

import radwrap
from invariance_relations.documents import Table, Written, lengths, metres, read_pose, scaled
from invariance_relations.drawing import draw_scene
from invariance_relations.relations import RELATIONS, Relation
from radwrap.frames import to_world
from radwrap.images import write_exr

Array = np.ndarray[Any, Any]

TOLERANCES: Final = (1.0, 2.0)  # gray levels rms
# Rays that an image may cost, times patches of light where there are many: the bound is then what they reach.
BUDGET_RAYS: Final = 2e5
FREE_PATCHES: Final = 20
# A base image whose bound is wider than this many tolerances at that price says nothing: the scene is passed over,
# before any relation is seen.
IDLE: Final = 3.0
# How often a correct image pair lies apart by more than the sum of its bounds. Each bound is passed in 5 % of the
# scenes (scripts/certificates.py); the sum only where e1^2 + e2^2 > (b1 + b2)^2, so where one of two errors passes
# its bound by sqrt(2). For errors of one degree of freedom, the longest tail, that is 2 P(|z| > 1.96 sqrt(2)) = 1.1 %.
CHANCE: Final = 0.0112
FALSE_ALARM: Final = 1e-3  # of a relation that holds, to be called broken
# Twice the sum is 2.8 bounds in one of two errors: P(|z| > 5.5) = 4e-8, which no number of scenes excuses.
GROSS: Final = 2.0


@dataclass(frozen=True, slots=True)
class Shown:
    """A scene's image: gray levels before rounding, and how far it may be off."""

    written: Written
    gray: Array
    bound: float
    wide: float
    method: str


def shown(written: Written, tolerance: float, seed: int) -> Shown:
    """Render a scene.

    Raises
    ------
    InputError
        If it is refused.
    """
    with tempfile.TemporaryDirectory() as folder:
        written.save(Path(folder))
        scene = radwrap.scene_from_document(written.document, folder=Path(folder))
        patches = max(len(scene.emitters), FREE_PATCHES)
        result = radwrap.render(
            scene, tolerance=tolerance, budget_rays=BUDGET_RAYS * FREE_PATCHES / patches, seed=seed, workers=1
        )
    gray = result.gray.values
    sensor = scene.camera.sensor
    # All light changed by the same share changes a gray level by gamma times it, and nothing where it saturates.
    share = max((float(source.get("irradiance_error", 0.0)) for source in written.sources), default=0.0)
    signal = np.where(gray < gray.max() if _saturates(gray, sensor) else True, gray - sensor.dark_gray, 0.0)
    wide = share * sensor.gamma * math.sqrt(float((signal**2).mean()))
    return Shown(written, gray, result.run.error.rms_gray_upper95, wide, result.run.method)


def _saturates(gray: Array, sensor: Any) -> bool:
    return bool(gray.max() >= sensor.saturation_gray)


def emitters(written: Written) -> int:
    """Discs and patches of all light."""
    with tempfile.TemporaryDirectory() as folder:
        written.save(Path(folder))
        return len(radwrap.scene_from_document(written.document, folder=Path(folder)).emitters)


@dataclass(frozen=True, slots=True)
class Case:
    """A drawn scene with its own image and the numbers from which everything else is drawn."""

    number: int
    written: Written
    tolerance: float
    base: Shown

    def random(self, name: str) -> np.random.Generator:
        """What a relation draws in this scene."""
        return np.random.default_rng([self.number, *name.encode()])


def case_of(number: int, most_patches: int = 4096) -> Case | str:
    """A scene by its number, rendered; or why there is nothing to compare, or that its light has too many patches."""
    try:
        written = draw_scene(number)
        if written is None:
            return f"{number}: dark, or even"
        tolerance = float(np.random.default_rng([number, 1]).choice(TOLERANCES))
        if emitters(written) > most_patches:
            return f"{number}: its light has more than {most_patches} patches"
        base = shown(written, tolerance, number)
    except radwrap.InputError as error:
        return f"{number}: {error}"
    return f"{number}: its bound is idle" if base.bound > IDLE * tolerance else Case(number, written, tolerance, base)


def judged(case: Case, name: str, plant: str | None = None) -> tuple[Table, Array, Shown] | None:
    """A relation on one scene: row, first image as the second should be, second image. None outside its domain."""
    relation = RELATIONS[name]
    if not relation.in_domain(case.written):
        return None
    written = relation.rewrite(case.written, case.random(name))
    if written is None:
        return None
    if plant is not None:
        written = PLANTS[plant](written)
    second = shown(written, case.tolerance, case.number + relation.seed)
    expected = relation.image(case.base.gray)
    row = {"relation": name, "number": case.number, **_held(relation, case.base, expected, second)}
    row["sources"] = [source["type"] for source in case.written.sources]
    row["targets"] = [f"{target['type']}:{target.get('material', '')}" for target in case.written.targets]
    return row, expected, second


def _held(relation: Relation, first: Shown, expected: Array, second: Shown) -> Table:
    difference = float(np.sqrt(((expected - second.gray) ** 2).mean()))
    allowed = first.bound + second.bound + (first.wide + second.wide if relation.recut else 0.0)
    same = bool(np.array_equal(expected, second.gray))
    return {
        "rms_gray": difference,
        "allowed_gray": allowed,
        "same_bytes": same,
        "holds": same if relation.holds == "to the byte" else difference <= allowed,
        "gross": not same if relation.holds == "to the byte" else difference > GROSS * allowed,
        "methods": [first.method, second.method],
    }


def allowed_failures(count: int) -> int:
    """Failures that chance makes in this many scenes, but for one run in 1/FALSE_ALARM."""
    return int(binom.isf(FALSE_ALARM, count, CHANCE))


def verdict(name: str, rows: list[Table]) -> Table:
    """What the rows of one relation say."""
    relation = RELATIONS[name]
    failures = [row for row in rows if not row["holds"] and "refused" not in row]
    judged_rows = [row for row in rows if "refused" not in row]
    allowed = 0 if relation.holds == "to the byte" else allowed_failures(len(judged_rows))
    gross = [row["number"] for row in failures if row["gross"]]
    refused = [row["number"] for row in rows if "refused" in row]
    return {
        "relation": name,
        "holds": relation.holds,
        "domain": relation.domain,
        "scenes": len(judged_rows),
        "failed": [row["number"] for row in failures],
        "allowed_by_chance": allowed,
        "gross": gross,
        "refused": refused,
        "median_share": float(np.median([row["rms_gray"] / row["allowed_gray"] for row in judged_rows or [_NONE]])),
        "kept": len(failures) <= allowed and not gross and not refused,
    }


_NONE: Final = {"rms_gray": 0.0, "allowed_gray": 1.0}


def run(case: Case, name: str, plant: str | None = None, keep: Path | None = None) -> Table | None:
    """Judge a relation on one scene; a pair that differs is kept in a folder. None outside the domain."""
    try:
        found = judged(case, name, plant)
    except radwrap.InputError as error:
        # What the scene was allowed, the rewritten one must be.
        return {"relation": name, "number": case.number, "refused": str(error), "holds": False, "gross": True}
    if found is None:
        return None
    row, expected, second = found
    if keep is not None and not row["holds"]:
        _keep(keep / f"{name}_{case.number}", case, expected, second, row)
    return row


def _keep(folder: Path, case: Case, expected: Array, second: Shown, row: Table) -> None:
    for part, written in (("first", case.written), ("second", second.written)):
        (folder / part).mkdir(parents=True, exist_ok=True)
        written.save(folder / part)
        (folder / part / "scene.json").write_text(json.dumps(written.document, indent=1))
    for file, image in (("expected", expected), ("found", second.gray), ("difference", second.gray - expected)):
        write_exr(folder / f"{file}.exr", image.astype(np.float32), channel="Y")
    (folder / "row.json").write_text(json.dumps(row, indent=1))


def _brighter(written: Written) -> Written:
    """All light 5 % brighter."""
    new = written.copied()
    new.camera["exposure_time"] = scaled(new.camera["exposure_time"], 1.05)
    return new


def _aside(written: Written) -> Written:
    """The main target by a hundredth of the view's width to the right, about half a pixel."""
    new = written.copied()
    camera, target = new.camera, next(t for t in new.targets if t["name"] == "board")
    pose, place = read_pose(camera), read_pose(target).position
    f = metres(camera["focal_length"]) if "focal_length" in camera else None
    distance = math.dist(pose.position, place)
    width = camera["sensor"]["columns"] * metres(camera["sensor"]["pixel_width"])
    step = 0.01 * width * distance / f if f else 0.0005 * distance
    right = np.array(to_world(pose, (step, 0.0, 0.0))) - np.array(pose.position)
    target["position"] = lengths(np.array(place) + right)
    return new


# Small errors of what a user may get wrong, put into the rewritten scene to see that a relation can fail.
PLANTS: Final[dict[str, Callable[[Written], Written]]] = {"light": _brighter, "pose": _aside}
