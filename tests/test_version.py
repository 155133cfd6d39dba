"""The version stands in one place, and is the installed one."""

import tomllib
from importlib.metadata import metadata, version
from pathlib import Path

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
