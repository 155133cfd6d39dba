"""Files of a fit."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from typing import Final

import numpy as np

from radwrap.files import write_bytes
from radwrap.fitting.told import Fit
from radwrap.images import png_bytes, write_exr, write_png
from radwrap.manifest import write_manifest

NUMBERS: Final = "fit.json"
SCENE: Final = "scene.toml"
RESIDUAL: Final = "residual.exr"
PICTURE: Final = "residual.png"
PAGE: Final = "index.html"
FILES: Final = (SCENE, RESIDUAL, PICTURE, PAGE, NUMBERS)
_MIDDLE: Final = 128
_STEP: Final = 25  # codes for each expected deviation: five of them end the scale

_HTML: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>radwrap fit</title><style>
body{{font:15px system-ui,sans-serif;margin:2rem auto;max-width:60rem;padding:0 1rem}}
table{{border-collapse:collapse}}td,th{{padding:.2rem .7rem;text-align:right;border-bottom:1px solid #8886}}
td:first-child,th:first-child{{text-align:left}}
img{{width:100%;max-width:32rem;image-rendering:pixelated}}</style></head><body>
<h1>{title}</h1>
<table><tr><th>key</th><th>value</th><th>deviation</th><th>95 %</th><th>begun at</th></tr>{rows}</table>
{undetermined}<h2>What is left</h2>
<p>(captured - predicted) / expected deviation: middle gray is 0, black -5, white +5. Pixels that are masked, or say
only "at least" or "at most" and agree, are middle gray.</p>
<img alt="residual" src="data:image/png;base64,{picture}">{worst}</body></html>
"""


def residual_codes(fit: Fit) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """The residual as 8 bits: 128 is none, 25 codes are an expected deviation."""
    codes = np.rint(_MIDDLE + _STEP * np.nan_to_num(fit.residual))
    return np.asarray(np.clip(codes, 0, 255), dtype=np.uint8)


def write_fit(fit: Fit, text: str, out: Path) -> None:
    """Write a fit's files, fit.json last and the scene after the residual, by which a folder of fits is known.

    Parameters
    ----------
    fit : Fit
        What was found.
    text : str
        The scene file with the values that were found.
    out : Path
        Folder that is there.
    """
    (out / NUMBERS).unlink(missing_ok=True)
    # A pixel that was not used has no residual: 0 is none.
    write_exr(out / RESIDUAL, np.nan_to_num(fit.residual).astype(np.float32), channel="residual")
    write_bytes(out / SCENE, text.encode())
    codes = residual_codes(fit)
    write_png(out / PICTURE, codes)
    write_bytes(out / PAGE, _page(fit, png_bytes(codes)).encode())
    write_manifest(out / NUMBERS, fit.manifest)


def _page(fit: Fit, picture: bytes) -> str:
    rows = []
    for key in fit.keys:
        sigma = "not determined" if key.sigma is None else f"{key.sigma:.2g}"
        interval = "" if key.interval is None else f"{key.interval[0]:.6g} to {key.interval[1]:.6g}"
        value, begin = (f"{number:.6g} {key.unit}".strip() for number in (key.value, key.begin))
        cells = (key.key, value, sigma, interval, begin)
        rows.append(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>")
    if not fit.converged:
        title = "The fit did not converge"
    elif not fit.verdict.is_judged:
        title = "Whether the scene explains the captures cannot be judged"
    else:
        title = f"The scene explains the captures within its errors: {'yes' if fit.explained else 'no'}"
    undetermined = ""
    if fit.undetermined:
        items = "".join(f"<li>{escape(line)}</li>" for line in fit.undetermined)
        undetermined = f"<h2>Not determined by the captures</h2><ul>{items}</ul>"
    items = "".join(f"<li>{escape(block.told())}</li>" for block in fit.verdict.worst)
    looks = "".join(f"<p>It looks as if {escape(one.told())}.</p>" for one in fit.looks_like)
    return _HTML.format(
        title=escape(title),
        rows="".join(rows),
        undetermined=undetermined,
        picture=base64.b64encode(picture).decode(),
        worst=f"<p>Where most is left:</p><ol>{items}</ol>{looks}",
    )
