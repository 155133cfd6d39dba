"""The version stands in one place, and is the installed one."""

import tomllib
from importlib.metadata import metadata, version
from pathlib import Path

from radwrap.manifest import COMPILER_PACKAGES, STUDY_PACKAGES, versions

ROOT = Path(__file__).parent.parent


def test_the_installed_version_is_the_projects() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert version("radwrap") == project["version"], "set the environment up again"
    told = f'"{project["version"]}"'
    others = [path for path in (ROOT / "radwrap").rglob("*.py") if told in path.read_text("utf-8")]
    assert not others, "the version is looked up, not written again"


def test_nothing_is_invented_of_whom_and_where() -> None:
    """Authors, addresses and places on the web are not known."""
    told = metadata("radwrap")
    for field in ("Author", "Author-email", "Maintainer", "Home-page", "Project-URL"):
        assert told.get(field) is None, field
    assert not any(line.startswith("License ::") for line in told.get_all("Classifier") or []), (
        "License-Expression has it"
    )
    assert told["License-Expression"] == "BSD-3-Clause"


def test_versions_are_those_that_packages_tell() -> None:
    """Radwrap looks for one line of what is told of a package; Python reads all of it."""
    named = ("numpy", "scipy", "pydantic", *STUDY_PACKAGES, *COMPILER_PACKAGES)
    found = versions(*named)
    assert {name: found[name] for name in named} == {name: version(name) for name in named}
    assert versions("radwrap-of-nobody")["radwrap-of-nobody"] == "not installed"
