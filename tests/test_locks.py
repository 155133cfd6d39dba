"""Lock files name one version of each package, with hashes, within the ranges of the project."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
LOCKS = ("requirements.lock", "requirements-docs.lock", "requirements-release.lock")
PYTHONS = ("3.11.7", "3.12.1", "3.13.0")


def _entries(name: str) -> list[tuple[Requirement, list[str]]]:
    """Packages of a lock file with their hashes."""
    text = "\n".join(line for line in (ROOT / name).read_text("utf-8").splitlines() if not line.startswith("#"))
    entries = [entry.split(" \\\n    ") for entry in re.split(r"\n(?=\S)", text.strip())]
    return [(Requirement(first), hashes) for first, *hashes in entries]


def _pins(name: str, python: str) -> dict[str, Requirement]:
    """What a lock file brings to a Python on Linux."""
    here = {**default_environment(), "python_full_version": python, "python_version": python.rpartition(".")[0]}
    found = [one for one, _ in _entries(name) if one.marker is None or one.marker.evaluate(here)]
    assert len({canonicalize_name(one.name) for one in found}) == len(found), "one version of each"
    return {canonicalize_name(one.name): one for one in found}


@pytest.mark.parametrize("name", LOCKS)
def test_each_package_is_pinned_with_its_hashes(name: str) -> None:
    entries = _entries(name)
    assert len(entries) > 30
    for package, hashes in entries:
        assert re.fullmatch(r"==[\w.]+", str(package.specifier)), package
        assert hashes and all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", one) for one in hashes), package
    assert "://" not in (ROOT / name).read_text("utf-8"), "no index is named: packages come from the user's own"


@pytest.mark.parametrize("python", PYTHONS)
def test_lock_files_agree_and_keep_to_the_ranges(python: str) -> None:
    """One environment may have all three."""
    pins = [_pins(name, python) for name in LOCKS]
    for one in pins[1:]:
        for name in one.keys() & pins[0].keys():
            assert one[name].specifier == pins[0][name].specifier
    for name in pins[1].keys() & pins[2].keys():
        assert pins[1][name].specifier == pins[2][name].specifier
    extras = PROJECT["project"]["optional-dependencies"]
    asked = [PROJECT["project"]["dependencies"], *(extras[name] for name in extras if name != "bench")]
    groups = PROJECT["dependency-groups"]
    for lock, lists in zip(pins, (asked, [groups["docs"]], [groups["release"]]), strict=True):
        for wanted in (Requirement(line) for lines in lists for line in lines):
            if wanted.name != "radwrap":
                version = str(lock[canonicalize_name(wanted.name)].specifier).removeprefix("==")
                assert wanted.specifier.contains(version), f"{wanted}, and {version} is locked"
