"""Take each defence of the page's server out, one at a time, and see the tests fail.

    .venv/bin/python scripts/face_defences.py [NAME ...]

Each is a change of a line or two in a copy of the package; the tests that hold it run on that copy. A defence that
can be taken out unseen ends the script with 1.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
_PATIENCE: Final = 300.0  # s for the tests of one defence


@dataclass(frozen=True, slots=True)
class Defence:
    """What is taken out.

    Attributes
    ----------
    name : str
        What it is against.
    file : str
        Module of radwrap/.
    line, without : str
        Text that is there once, and what stands there without the defence.
    tests : str
        File of tests/face and an expression that chooses tests.
    """

    name: str
    file: str
    line: str
    without: str
    tests: tuple[str, str]


GATE: Final = "face/gate.py"
DEFENCES: Final = (
    Defence("DNS rebinding", GATE, "if len(hosts) != 1 or hosts[0] not in self._hosts:", "if False:", ("gate", "host")),
    Defence("absolute URI", GATE, 'if not raw.startswith(b"/"):', "if False:", ("gate", "bad_form")),
    Defence("foreign origin", GATE, "if origins and origins !=", "if False and origins !=", ("gate", "another_sites")),
    Defence("fetch site", GATE, "if not _same_site(scope, all_of):", "if False:", ("gate", "asking_site")),
    Defence("framing", GATE, 'all_of(b"sec-fetch-dest") == [b"document"]', "True", ("gate", "asking_site")),
    Defence("token", GATE, "if not hmac.compare_digest(given, self._token):", "if False:", ("gate", "needs_the_token")),
    Defence(
        "constant time",
        GATE,
        "if not hmac.compare_digest(given, self._token):",
        "if given != self._token:",
        ("gate", "constant"),
    ),
    Defence("form bodies", GATE, "!= [door.content]:", "== []:", ("gate", "only_json")),
    Defence("methods", GATE, 'if scope["method"] != door.method:', "if False:", ("gate", "only_json or own_files")),
    Defence(
        "encoded paths",
        GATE,
        ' if b"%" not in raw and raw == scope["path"].encode() else None',
        "",
        ("gate", "word_of_a_table"),
    ),
    Defence("long bodies", GATE, "if size > largest:", "if False:", ("gate", "bodies")),
    Defence(
        "long texts of knobs", "imaging/page/turn.py", "len(value.strip()) > _LONGEST", "False", ("turns", "bad_turn")
    ),
    Defence("announced long bodies", GATE, "int(lengths[0][:12]) > door.largest", "False", ("gate", "bodies")),
    Defence("slow bodies", GATE, "BODY_PATIENCE: Final = 5.0", "BODY_PATIENCE: Final = 500.0", ("gate", "slow")),
    Defence(
        "headers",
        GATE,
        '"headers": [*message.get("headers", []), *HEADERS]',
        '"headers": message["headers"]',
        ("gate", "own_files"),
    ),
    Defence(
        "headers of refusals",
        GATE,
        '(b"connection", b"close"), *HEADERS]',
        '(b"connection", b"close")]',
        ("gate", "refusals"),
    ),
    Defence(
        "slow heads",
        "face/serve.py",
        "HEADER_PATIENCE: Final = 5.0",
        "HEADER_PATIENCE: Final = 500.0",
        ("gate", "slow"),
    ),
    Defence(
        "other machines",
        "face/serve.py",
        'LOOPBACK: Final = "127.0.0.1"',
        'LOOPBACK: Final = "0.0.0.0"',
        ("gate", "alone"),
    ),
    Defence("other users", "face/serve.py", "os.O_EXCL, 0o600)", "os.O_EXCL, 0o644)", ("gate", "token_stands")),
    Defence("logs", "face/serve.py", "if sys.stderr.isatty():", "if True:", ("gate", "token_stands")),
    Defence("what a signal leaves", "face/serve.py", "            session.close()\n", "", ("life", "signal")),
    Defence(
        "orphans' folders",
        "face/renderer.py",
        "self.orphaned = True",
        "self.orphaned = False",
        ("life", "killed_server"),
    ),
    Defence(
        "orphaned renderers",
        "face/renderer.py",
        "        self.asked.put(None)\n",
        "        threading.Event().wait()\n",
        ("life", "killed_server"),
    ),
    Defence(
        "folders of servers killed at once",
        "face/renderer.py",
        "with suppress(OSError):  # the server is gone already",
        "if True:  # the server is gone already",
        ("life", "loses_its_server"),
    ),
    Defence("killing what may stay warm", "face/renderer.py", "child.tell(_STOP)", "pass", ("life", "stopped_begun")),
    Defence(
        "renderers that hang",
        "face/renderer.py",
        "now - asked_to_stop > OBEYS_WITHIN",
        "False",
        ("life", "stopped_begun"),
    ),
    Defence(
        "photos of other kinds",
        "face/decoder.py",
        "if begin.startswith(magic)), None)",
        '), ".png")',
        ("photo", "not_even_tried"),
    ),
    Defence(
        "photos that take long", "face/decoder.py", "(resource.RLIMIT_CPU, SECONDS),", "", ("photo", "limits_itself")
    ),
    Defence("photos that hang", "face/photo.py", "limits=LIMITS,", "limits=Limits(),", ("photo", "decodes_with")),
    Defence(
        "photos that take memory", "face/decoder.py", "(resource.RLIMIT_AS, MEMORY),", "", ("photo", "limits_itself")
    ),
    Defence(
        "photos on the disk",
        "face/decoder.py",
        "resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))",
        "pass",
        ("photo", "limits_itself"),
    ),
    Defence(
        "photos of strangers",
        GATE,
        "if refused is None and door is not None and door.is_wide:",
        "if door is not None and door.is_wide:",
        ("photo", "knows"),
    ),
    Defence(
        "many photos at a time",
        GATE,
        "            async with self._wide:\n",
        "            if True:\n",
        ("photo", "at_a_time"),
    ),
    Defence(
        "photos of another size",
        "face/decoder.py",
        "if image.values.shape != (rows, columns):",
        "if False:",
        ("photo", "clear_error"),
    ),
    Defence(
        "shifted bits",
        "face/photo.py",
        "if whole and wide and highest > 0 and not (values % step).any():",
        "if False:",
        ("photo", "upper_end"),
    ),
    Defence(
        "rings whose page is gone",
        "face/ring.py",
        "if time.monotonic() - self._heard > MISSED:",
        "if False:",
        ("ring", "knobs_stand"),
    ),
    Defence(
        "rings of two tabs",
        "face/ring.py",
        "if self._holder not in (None, name):",
        "if False:",
        ("ring", "knobs_stand"),
    ),
    Defence("rings that nobody asked for", "face/app.py", "[] if ring is None else ", "", ("ring", "no_such_route")),
    Defence(
        "light that nobody agreed to", "cli/face.py", '.strip() != "yes"', '.strip() == "no"', ("ring", "confirmed")
    ),
    Defence("closed pages", "face/app.py", "        if alone and", "        if False and", ("life", "closed")),
    Defence(
        "stale bases",
        "face/session.py",
        "or (number is not None and number != found.number)",
        "",
        ("turns", "bad_requests"),
    ),
    Defence(
        "keys beside the knobs",
        "face/ray_knobs.py",
        "or not set(told) <= set(known):",
        "or False:",
        ("ray_knobs", "nothing_else or server_takes"),
    ),
    Defence("coarse pictures", "face/session.py", "if found.coarse is not None:", "if False:", ("coarse", "stopped")),
    Defence(
        "stops between renders",
        "face/renderer.py",
        "        if self._stop.is_set():\n            raise _stopped(again)\n        self._asked",
        "        self._stop.clear()\n        self._asked",
        ("coarse", "between"),
    ),
    Defence(
        "names that end scripts", "imaging/page/one_file.py", '.replace("<", "\\\\u003c")', "", ("export", "hostile")
    ),
    Defence("exported policy", "imaging/page/one_file.py", "{head}<style>", "<style>", ("export", "own_scripts")),
    Defence(
        "trades whose page is gone",
        "face/app.py",
        "loop.run_in_executor(None, self._session.end_trade, heard)",
        "pass",
        ("trade", "hangs_up"),
    ),
    Defence("trades that begin for nobody", "face/session.py", "if unwanted():", "if False:", ("trade", "nobody_else")),
    Defence(
        "trades of other tabs",
        "face/session.py",
        "if self._measured_for is told:",
        "if True:",
        ("trade", "nobody_else"),
    ),
    Defence(
        "several trades at a time",
        "face/session.py",
        "free = not tracing and self._measuring.acquire(blocking=False)",
        "free = not tracing",
        ("trade", "nobody_else or hangs_up"),
    ),
    Defence(
        "trades that take long",
        "face/trading.py",
        "return TradeOptions(longest=found).longest",
        "return found",
        ("trade", "no_time"),
    ),
    Defence(
        "trades in the way of a trace",
        "face/session.py",
        "        self._end_measuring()\n",
        "",
        ("matters", "ends_the_measurement"),
    ),
)


def main() -> int:
    """Take out one after the other, or those that are named; returns 1 where that is not seen."""
    unseen, named = [], sys.argv[1:]
    chosen = [defence for defence in DEFENCES if not named or defence.name in named]
    for defence in chosen:
        seen = _is_seen(defence)
        place = f"radwrap/{defence.file}, tests/face/test_{defence.tests[0]}.py"
        print(f"{'seen  ' if seen else 'UNSEEN'}  {defence.name} ({place})", flush=True)
        unseen += [] if seen else [defence.name]
    print(f"{len(chosen) - len(unseen)} of {len(chosen)} seen")
    return 1 if unseen else 0


def _is_seen(defence: Defence) -> bool:
    file, chosen = defence.tests
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("radwrap", "tests"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "node_modules"))
        for name in ("pyproject.toml", "NOTICE"):
            shutil.copy(ROOT / name, copy / name)
        module = copy / "radwrap" / defence.file
        text = module.read_text("utf-8")
        if text.count(defence.line) != 1:
            raise SystemExit(f"{defence.name}: its text stands in {defence.file} {text.count(defence.line)} times")
        module.write_text(text.replace(defence.line, defence.without), "utf-8")
        argv = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-x",
            "-p",
            "no:cacheprovider",
            "-m",
            "",
            f"tests/face/test_{file}.py",
            "-k",
            chosen,
        ]
        environment = {**os.environ, "PYTHONPATH": str(copy)}
        try:
            done = subprocess.run(
                argv, cwd=copy, env=environment, capture_output=True, text=True, timeout=_PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            return True  # what should have ended has not
        if done.returncode not in (0, 1):
            raise SystemExit(
                f"{defence.name}: pytest ended with {done.returncode}: {done.stdout[-2000:]}{done.stderr[-500:]}"
            )
        return done.returncode == 1


if __name__ == "__main__":
    sys.exit(main())
