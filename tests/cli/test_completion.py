"""Completion: bash itself is asked what it would complete."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cli.conftest import here

BASH = shutil.which("bash")
# What bash does after the tabulator key: it calls the function that the script has registered.
ASKED = """
source "$1"; shift
of=$(complete -p radwrap | sed 's/.*-F \\([^ ]*\\).*/\\1/')
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
$of radwrap "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.skipif(BASH is None, reason="there is no bash to ask")
def test_bash_completes_verbs_options_choices_and_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "a script"
    script.write_text(here(["completion", "bash"], capsys).success().stdout)
    (tmp_path / "scene one.toml").write_text("")
    (tmp_path / "scenes").mkdir()

    def completed(*words: str) -> list[str]:
        done = subprocess.run(
            [str(BASH), "-c", ASKED, "bash", str(script), "radwrap", *words],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
        )
        return sorted(done.stdout.split("\n")[:-1])

    assert completed("re") == ["relight", "render"]
    assert completed("study", "tol") == ["tolerate"]
    assert completed("render", "--toler") == ["--tolerance"]
    assert completed("render", "--tracer", "") == ["auto", "compiled", "radiance"]
    assert completed("render", "sce") == ["scene one.toml", "scenes"]
    assert completed("render", "--out", "sce") == ["scenes"]


@pytest.mark.parametrize(("shell", "of"), [("zsh", "#compdef radwrap"), ("fish", "complete -c radwrap")])
def test_other_shells_have_scripts_of_their_own(shell: str, of: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = here(["completion", shell], capsys).success().stdout
    assert of in text
    assert "tolerance" in text
    program = shutil.which(shell)
    if program is not None:
        assert subprocess.run([program, "-n"], input=text, text=True, check=False).returncode == 0


def test_another_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    done = here(["completion", "tcsh"], capsys)
    assert done.code == 2
    assert "choose from" in done.stderr
