"""The manifest as values with types: it holds all that manifest.json does, and a damaged one is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.demand import SamplingPlan
from radwrap.imaging.output.folder import is_whole
from radwrap.imaging.output.run_manifest import MANIFEST, read_run_manifest, run_manifest_of, write_run_manifest
from radwrap.manifest import SCHEMA_VERSION
from tests.imaging.test_synthesis import scene

MATT = {"type": "lambertian", "reflectance": 0.5}  # sheeting has no bounces
HOW: list[dict[str, Any]] = [
    {"viewpoints": 7},
    {"method": "pinhole", "pixel_samples": 2},
    {"tolerance": 20.0},
    {"tolerance": 20.0, "max_error": 200.0, "bounces": 1},
    {"tolerance": 20.0, "sampling": SamplingPlan("rays", rays=4)},
]


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results; not to be changed."""
    folder = tmp_path_factory.mktemp("once")
    radwrap.render(scene(), folder, viewpoints=1)
    return folder


@pytest.fixture
def told(once: Path, tmp_path: Path) -> dict[str, Any]:
    """What the manifest of the results in "made" says."""
    shutil.copytree(once, tmp_path / "made")
    manifest: dict[str, Any] = json.loads((tmp_path / "made" / MANIFEST).read_bytes())
    return manifest


@pytest.mark.parametrize("how", [*(pytest.param(how, marks=pytest.mark.long) for how in HOW[:3]), *HOW[3:]], ids=str)
def test_all_of_manifest_json_comes_back_and_is_written_again_in_its_order(how: dict[str, Any], tmp_path: Path) -> None:
    changes = {"materials.sheeting": MATT} if "bounces" in how else {}
    made = radwrap.render(scene(**changes), tmp_path / "made", workers=1, **how)
    (tmp_path / "again").mkdir()
    write_run_manifest(tmp_path / "again", read_run_manifest(tmp_path / "made"))
    first, again = (json.loads((tmp_path / name / MANIFEST).read_bytes()) for name in ("made", "again"))
    assert again == first == made.manifest
    assert list(again) == list(first)
    assert made.run.met == made.manifest.get("plan", {}).get("met", True)
    assert made.run.error.rms_gray_upper95 == made.manifest["error"]["rms_gray_upper95"]
    # A largest error is named where there is a tolerance, whether or not one was asked for.
    assert ("max_error" in first) == ("tolerance" in first) == ("plan" in first) == ("tolerance" in how)
    assert first.get("max_error") == how.get("max_error")


def test_a_key_of_a_later_radwrap_is_left_out_and_another_schema_is_refused(
    told: dict[str, Any], tmp_path: Path
) -> None:
    assert run_manifest_of({**told, "later": {"more": 1}}, MANIFEST) == run_manifest_of(told, MANIFEST)
    (tmp_path / MANIFEST).write_text(json.dumps({**told, "schema_version": SCHEMA_VERSION + 1}))
    with pytest.raises(InputError, match=f"is not a manifest of schema version {SCHEMA_VERSION}"):
        read_run_manifest(tmp_path)


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("error", "rms_gray_upper95"), -1.0),
        (("error", "rms_gray"), "0.5"),
        (("saturated_fraction",), 1.5),
        (("gray", "max"), None),
        (("files", "../gray.png"), 64 * "a"),
        (("method",), "magic"),
        (("timing", "workers"), 0),
        (("left_out", "bounces", "needed"), 1),
    ],
)
def test_a_damaged_manifest_is_refused_with_its_key(keys: tuple[str, ...], value: Any, told: dict[str, Any]) -> None:
    place = told
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises(InputError, match=rf"^manifest\.json: {keys[0]}.*make it again"):
        run_manifest_of(told, MANIFEST)


def test_a_folder_is_whole_while_its_files_are_as_its_manifest_says(told: dict[str, Any], tmp_path: Path) -> None:
    folder = tmp_path / "made"
    assert is_whole(folder) and is_whole(folder, told["run_sha256"])
    assert not is_whole(folder, 64 * "0") and not is_whole(tmp_path)
    (folder / "gray.png").write_bytes(b"")
    assert not is_whole(folder)
