"""The page with its basis in one HTML file: knobs without a server, in a mail, in docs, in a notebook."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError
from radwrap.files import write_bytes
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.page.bundle import script_of, shipped
from radwrap.imaging.page.described import described, told_of, told_thresholds
from radwrap.imaging.page.thresholds import thresholds
from radwrap.imaging.page.turn import spelled
from radwrap.imaging.relight.relit import Basis, Relighter
from radwrap.imaging.relight.relit_uncertainty import relit_uncertainty
from radwrap.scene.scene import Scene

LARGEST: Final = 4 << 20  # byte of a file; a mail and a notebook take it
_MOST_BINNED: Final = 64
_BASE64: Final = 4 / 3
_LINKS: Final = re.compile(r"<(?:link|script)\b[^>]*>(?:</script>)?\n")


@dataclass(frozen=True, slots=True, repr=False)
class Page:
    """A page in one file; a notebook shows it, in a frame that can do nothing else.

    Attributes
    ----------
    html : str
        The file.
    binned : int
        So many pixels a side are one, that it is not too large; 1 where none are.
    """

    html: str
    binned: int

    def __repr__(self) -> str:
        pixels = f", {self.binned} x {self.binned} pixels are one" if self.binned > 1 else ""
        return f"<Page: {len(self.html) / 1e6:.1f} MB{pixels}>"

    def _repr_html_(self) -> str:
        return (
            '<iframe title="radwrap" width="100%" height="900" style="border: 0" sandbox="allow-scripts '
            f'allow-downloads" srcdoc="{html.escape(self.html)}"></iframe>'
        )

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all; raises as `write_bytes`."""
        write_bytes(Path(path), self.html.encode())


def one_file(scene: Scene, basis: Basis, run: RunManifest, words: Sequence[str] | None = None) -> Page:
    """The page of a basis at its scene's own levels.

    Parameters
    ----------
    scene, basis, run
        What was rendered, and how.
    words : sequence of str, optional
        Of the command that makes the basis, without its folder; empty where it cannot be told. Default what scene and
        run say, to which the scene's file is as it was read.

    Raises
    ------
    InputError
        If the file would be too large even with 64 x 64 pixels as one, as with thousands of sources.
    """
    binned = _binning(basis)
    told = {
        "basis": 0,
        **described(scene, basis, run),
        "rows": -(-basis.sensor.rows // binned),
        "columns": -(-basis.sensor.columns // binned),
        "binned": binned,
        "mixes": True,
        "saves": False,
    }
    factors = np.ones(len(basis.sources))
    image = Relighter(basis).image(factors)
    sigma = relit_uncertainty(basis, factors, image).sigma
    found = thresholds(basis.sensor)
    made = _words(scene, run) if words is None else tuple(words)
    command = spelled((*made, "--out", "basis"), ("radwrap", "relight", "basis", "--out", "turned")) if made else ""
    certified = {
        **told_of(image, basis, sigma),
        "thresholds": told_thresholds(found),
        "command": command,
    }
    means = (parts.mean(axis=0, dtype=np.float64) for parts in basis.images)
    planes = [_packed(_mean(plane, binned)) for plane in means]
    blocks = {
        "values": _packed(found.values),
        "exposure": _packed(_mean(image.radiant_exposure.values, binned)),
        "sigma": _packed(_mean(sigma, binned)),
    }
    data = {"described": told, "told": certified, "planes": planes, **blocks}
    return Page(_assembled(_finite(data)), binned)


def _words(scene: Scene, run: RunManifest) -> tuple[str, ...]:
    if not scene.origin.endswith(".toml"):  # it came from no file
        return ()
    tolerance = () if run.tolerance is None else ("--tolerance", f"{run.tolerance!r}")
    seed = ("--seed", str(run.seed)) if run.seed else ()
    return ("radwrap", "render", scene.origin, *tolerance, *seed, "--basis")


def _binning(basis: Basis) -> int:
    """How many pixels a side must become one."""
    sensor = basis.sensor
    room = LARGEST - len(_assembled({})) - (1 << 18)  # of the page itself, of thresholds and of what is told
    for binned in range(1, _MOST_BINNED + 1):
        pixels = -(-sensor.rows // binned) * -(-sensor.columns // binned)
        if (len(basis.sources) + 2) * pixels * 4 * _BASE64 <= room:
            return binned
    raise InputError(f"{len(basis.sources)} sources do not fit into one file", where="page", remedy="serve the page")


def _mean(values: NDArray[np.float64], binned: int) -> NDArray[np.float64]:
    """Mean of blocks of pixels; those at the far ends may be smaller."""
    if binned == 1:
        return values
    starts = [np.arange(0, size, binned) for size in values.shape]
    sums = np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1)
    sizes = [np.diff([*start, size]) for start, size in zip(starts, values.shape, strict=True)]
    mean: NDArray[np.float64] = sums / np.outer(*sizes)
    return mean


def _packed(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _finite(value: Any) -> Any:
    """JSON knows no infinity: what has no bound is null."""
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _assembled(data: Any) -> str:
    """One HTML file; scripts and styles are known to its policy by their hashes, and nothing else may run or load."""
    scripts = [shipped("vendor/uPlot.iife.min.js"), script_of("exported.js")]
    style = shipped("vendor/uPlot.min.css") + shipped("style.css")
    # No text in the data ends the element that it stands in.
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    body = _LINKS.sub("", shipped("index.html"))
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_known, scripts))}; style-src {_known(style)}; "
        "img-src blob:; worker-src blob:; base-uri 'none'; form-action 'none'"
    )
    head = f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
    holders = [
        f'<script type="text/plain" id="worker">{script_of("worker.js")}</script>',
        f'<script type="application/json" id="data">{text}</script>',
        *(f"<script>{script}</script>" for script in scripts),
    ]
    body = body.replace('<meta charset="utf-8">\n', f'<meta charset="utf-8">\n{head}<style>{style}</style>\n')
    return body.replace("</body>", "\n".join([*holders, "</body>"]))


def _known(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"
