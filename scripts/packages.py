"""Wheel and sdist, built twice: ``make packages``.

The second build begins with the first one's sdist, in another folder and at another time. Same bytes say that a package
hangs on its sources only, and that the sdist is whole.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).resolve().parent.parent
OUT: Final = HERE / "out" / "dist"


def main() -> int:
    """0 if both builds agree and the index would take them, 1 if not."""
    for old in OUT.glob("radwrap-*"):
        old.unlink()
    first = built(HERE, OUT)
    with tempfile.TemporaryDirectory() as folder:
        (sdist,) = OUT.glob("*.tar.gz")
        with tarfile.open(sdist) as archive:
            archive.extractall(folder, filter="data")
        second = built(Path(folder) / sdist.name.removesuffix(".tar.gz"), Path(folder) / "dist")
    for name, digest in first.items():
        fault = "" if second.get(name) == digest else ": the second build differs"
        print(f"{digest}  {OUT / name}, {(OUT / name).stat().st_size} bytes{fault}", flush=True)
    checked = subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *OUT.glob("radwrap-*")], check=False)
    return int(first != second or checked.returncode != 0)


def built(source: Path, out: Path) -> dict[str, str]:
    """SHA-256 of wheel and sdist, by their names."""
    argv = [sys.executable, "-m", "hatchling", "build", "-d", out]
    subprocess.run(argv, cwd=source, check=True, stdout=subprocess.DEVNULL)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.iterdir())}


if __name__ == "__main__":
    raise SystemExit(main())
