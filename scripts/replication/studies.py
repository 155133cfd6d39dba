"""Table 3 by the whole chain: designs from study_table2 and a variant, a study for each seed, effects of each."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from radwrap.errors import InputError
from radwrap.files import make_folder, write_bytes
from radwrap.manifest import read_manifest
from radwrap.measure.dots import METHODS
from radwrap.study.design import read_design
from radwrap.study.effects import analyse, as_json
from radwrap.study.levels import read_data
from radwrap.study.study import STUDY, StudyOptions, run_study
from radwrap.study.table import read_table
from replication.images import COARSE, FEW_DRAWS
from replication.published import ROOT

DESIGN: Final = ROOT / "rad_scenes" / "study_table2" / "design.toml"
RUNS: Final = 16
NOMINAL_METHOD: Final = "gray"  # assumptions.centre_method of published.toml
NEGATIVE: Final = {
    "name": "tilt_negative",
    "opens": "tilt_sign",
    "what": "-46 degrees about x",
    "set": {"targets[0].rotation": ["-46 deg", "6 deg", "-2 deg"]},
}
NOMINAL: Final[Mapping[str, Any]] = {"name": "nominal", "opens": "", "what": "all assumptions as listed"}
# Errors of the other methods' focal lengths matter little: they are known to 30 %.
_DRAWS: Final = 6
_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True, slots=True)
class Draw:
    """What one seed of one variant gave by one centre method.

    Attributes
    ----------
    variant, method : str
    seed : int
    effects : Mapping of str to Mapping
        "A", ... -> effect [mm], its error by the images, t, significant.
    focal_lengths : Mapping of str to float
        "LLLL", ... -> f [mm].
    errors : Mapping of str to float
        The same for the errors by the images [mm].
    pse : float
        [mm].
    """

    variant: str
    method: str
    seed: int
    effects: Mapping[str, Mapping[str, Any]]
    focal_lengths: Mapping[str, float]
    errors: Mapping[str, float]
    pse: float


def design_of(variant: Mapping[str, Any], seed: int, folder: Path, *, coarse: bool = False) -> dict[str, Any]:
    """Tables of a design file: study_table2 with one thing changed."""
    design = deepcopy(tomllib.loads(DESIGN.read_text("utf-8")))
    scene = ROOT / "rad_scenes" / variant.get("scene", "fig13_oriented_board") / "scene.toml"
    design["title"] = f"Table 3: {variant['what']}, seed {seed}"
    design["scene"] = os.path.relpath(scene, folder)
    design["seed"] = seed
    design["set"] = {**variant.get("set", {}), **(COARSE if coarse else {})}
    design["render"] = variant.get("render", {"tolerance": 0.5})
    for name, levels in variant.get("levels", {}).items():
        design["factors"][name]["levels"] |= levels
    for name in "BCD" if variant.get("draws") else "":
        design["factors"][name]["draws"] = variant["draws"]
    for key, draw in variant.get("also_draw", {}).items():
        first = design["factors"]["A"]
        first["keys"].append(key)
        first["levels"] = {name: [*values, draw] for name, values in first["levels"].items()}
    # The centre methods are one open assumption, held beside each other at the nominal system and at the other tilt.
    methods = METHODS if variant in (NOMINAL, NEGATIVE) and not coarse else (NOMINAL_METHOD,)
    design["responses"] = {f"f_{method}": _response(method, variant) for method in methods}
    if coarse:
        design["render"] = {"method": "pinhole"}
        design["responses"][f"f_{NOMINAL_METHOD}"] |= FEW_DRAWS
    return design


def _response(method: str, variant: Mapping[str, Any]) -> dict[str, Any]:
    fewer = {} if method == NOMINAL_METHOD else {"draws": _DRAWS}
    return {"measure": "focal_length", "unit": "mm", "method": method, **fewer, **variant.get("responses", {})}


def toml_text(tables: Mapping[str, Any]) -> str:
    """A TOML file of one line for each of its keys."""
    return "".join(f"{_key(name)} = {_inline(value)}\n" for name, value in tables.items())


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else json.dumps(name)


def _inline(value: Any) -> str:
    match value:
        case dict():
            return "{ " + ", ".join(f"{_key(name)} = {_inline(item)}" for name, item in value.items()) + " }"
        case list():
            return "[" + ", ".join(map(_inline, value)) + "]"
    return json.dumps(value)


def folder_of(variant: Mapping[str, Any], seed: int, out: Path) -> Path:
    """Where the design of a seed lies, and its study below that."""
    return out / variant["name"] / f"seed{seed:02d}"


def is_finished(variant: Mapping[str, Any], seed: int, out: Path) -> bool:
    """Whether all its runs are done."""
    path = folder_of(variant, seed, out) / "study" / STUDY
    return path.is_file() and "results" in read_manifest(path)  # before its last run it says how runs are sampled only


def run(variant: Mapping[str, Any], seed: int, out: Path, *, coarse: bool = False, workers: int | None = None) -> Path:
    """Carry out one study of 16 images, as far as its folder does not hold it already; the folder.

    The design file in it is what `radwrap study run` takes.
    """
    folder = folder_of(variant, seed, out)
    make_folder(folder)
    path = folder / "design.toml"
    write_bytes(path, toml_text(design_of(variant, seed, folder, coarse=coarse)).encode())
    run_study(read_design(path), folder / "study", StudyOptions(workers=workers, progress=True))
    return folder / "study"


def draws_of(variant: str, seed: int, study: Path) -> Iterator[Draw]:
    """Effects by each centre method that gave all 16 focal lengths."""
    rows = read_table(study / "results.csv").rows
    names = ["".join(row[name] for name in "ABCD") for row in rows]
    if len(set(names)) != RUNS:  # a folder that somebody copied half
        return
    for method in METHODS:
        column, error = f"f_{method} [mm]", f"f_{method}_error [mm]"
        if not all(row.get(column) for row in rows):
            continue
        try:
            analysis = as_json(analyse(read_data(study / "results.csv", f"f_{method}", list("ABCD"))))
        except InputError:
            continue
        yield Draw(
            variant=variant,
            method=method,
            seed=seed,
            effects=analysis["effects"],
            focal_lengths={name: float(row[column]) for name, row in zip(names, rows, strict=True)},
            errors={name: float(row[error]) for name, row in zip(names, rows, strict=True)},
            pse=analysis["pse"],
        )


def mean_error_percent(draw: Draw, rows: tuple[str, ...], true: float) -> float:
    """Mean |f - true|/true [%] of some rows of the design."""
    return float(np.mean([abs(draw.focal_lengths[row] - true) / true * 100 for row in rows]))
