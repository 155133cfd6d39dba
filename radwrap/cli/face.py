"""``radwrap face``."""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import webbrowser
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from radwrap.cli import options as shared
from radwrap.cli.led_device import add_device, add_light, ring_of
from radwrap.errors import InputError, ToleranceNotMet
from radwrap.extras import require
from radwrap.files import make_folder
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.colour_planes import refuse_mosaic
from radwrap.scene.instants import refuse_time
from radwrap.scene.scene import Scene

_DESCRIPTION: Final = (
    "Shows a scene in the browser: turn light levels, exposure and sensor, and see gray levels with their error. The "
    "page is served on this machine only, until Ctrl-C."
)
_LARGEST_PORT: Final = 65535
_PLACE: Final = re.compile(r"""[=\s"'\[,](/|~|\.\./|\\\\|[A-Za-z]:[\\/])""")  # where a path of this machine may begin


def add_to(verbs: argparse._SubParsersAction[Any]) -> None:
    """Add the verb."""
    parser = verbs.add_parser("face", description=_DESCRIPTION)
    shared.add_scene(parser)
    shared.add_tolerance(parser, "largest rms error of the picture that is traced")
    parser.add_argument(
        "--port", metavar="N", type=shared.whole(0, _LARGEST_PORT), default=0, help="default any free one"
    )
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser, only show where the link is")
    parser.add_argument("--out", metavar="DIR", help="folder in which the page's Save leaves its files, and the basis")
    parser.add_argument(
        "--export",
        metavar="PAGE.html",
        help="serve nothing, but write the page and its basis as one file of at most 4 MB, which needs no server",
    )
    parser.add_argument(
        "--study", metavar="DIR", type=Path, help="show the results of the study in this folder beside the picture"
    )
    parser.add_argument(
        "--seed", metavar="S", type=shared.whole(), default=0, help="seed of all random draws (default 0)"
    )
    shared.add_tracer(parser)
    add_light(parser, "--led")
    add_device(parser)
    parser.set_defaults(run=run, ahead=None)


def run(arguments: argparse.Namespace) -> int:
    """Carry out the verb."""
    scene = shared.load(arguments)
    refuse_mosaic(scene, "the page")
    refuse_time(scene, "the page")
    options = _options(arguments)
    RenderOptions(**options, basis=True)  # what is wrong is told now
    out = Path(arguments.out) if arguments.out else None
    if arguments.out is not None:
        if out is None:
            raise InputError("has no name", where="--out", remedy="name a folder")
        make_folder(out)
    _check_led(arguments)
    if arguments.export is not None:
        return _export(arguments, scene, options)
    require("face", "face")
    from radwrap.face.recipe import Recipe
    from radwrap.face.serve import serve

    study = None
    if arguments.study is not None:
        from radwrap.face.matters import study_told

        study = study_told(arguments.study)
    browser = None if arguments.no_browser or not _has_screen() else _open
    recipe = Recipe(_words(arguments), arguments.scene, shared.overrides_of(arguments), _unusual(options))
    ring = None
    if arguments.drive is not None:
        _confirm(arguments, scene)
        ring = partial(ring_of, arguments, scene)
    serve(
        scene,
        options,
        port=arguments.port,
        out=out,
        recipe=recipe,
        study=study,
        ring=ring,
        opened=browser,
        ahead=arguments.ahead,
    )
    return 0


def _check_led(arguments: argparse.Namespace) -> None:
    """Options of the ring go with it only, and no file can light it."""
    if arguments.drive is not None:
        if arguments.export is not None:
            raise InputError("needs the server", where="--led", remedy="leave out --export")
        if arguments.calibration is None and arguments.full_scale is None:
            what = "needs to know how bright a level is"
            raise InputError(what, where="--led", remedy="give --calibration or --full-scale")
        return
    for name in ("calibration", "full_scale", "which", "emulate", "count"):
        if getattr(arguments, name) is not None:
            option = "device" if name == "which" else name.replace("_", "-")
            raise InputError("is of the LED ring", where=f"--{option}", remedy="give --led DRIVE.toml too")
    if arguments.emulator:
        raise InputError("is of the LED ring", where="--emulator", remedy="give --led DRIVE.toml too")


def _confirm(arguments: argparse.Namespace, scene: Scene) -> None:
    """Somebody at the terminal must agree that a page may light a real ring; an emulated one gives no light."""
    if arguments.emulate is not None or arguments.emulator:
        return
    with ring_of(arguments, scene) as ring:
        told, drive = ring.capabilities, ring.drive
    if not sys.stdin or not sys.stdin.isatty():
        raise InputError("must be confirmed in a terminal", where="--led", remedy="start the command in one")
    nanometres = "" if drive is None else f" of {drive.wavelength * 1e9:.0f} nm"
    print(
        f"radwrap: the page may light {told.count} LEDs{nanometres} of the ring with the serial "
        f'{told.serial or "none"}, without warning: nobody may look into them. Type "yes" to allow it: ',
        end="",
        file=sys.stderr,
        flush=True,
    )
    if sys.stdin.readline().strip() != "yes":
        raise InputError("was not confirmed", where="--led")


def _export(arguments: argparse.Namespace, scene: Scene, options: dict[str, Any]) -> int:
    """Render, and write the page as one file."""
    # Here, as the page itself waits for none of it.
    from radwrap.imaging.page.one_file import one_file
    from radwrap.imaging.relight.relit import read_basis
    from radwrap.imaging.synthesis import render

    path = shared.file_to_write(arguments.export, "--export", ".html", others=(arguments.scene,))
    with tempfile.TemporaryDirectory(prefix="radwrap-") as folder:
        made = render(scene, folder, basis=True, progress=True, **options)
        page = one_file(made.scene, read_basis(Path(folder)), made.run, _words_for_others(arguments))
    if path is not None:
        page.save(path)
    pixels = f"; {page.binned} x {page.binned} pixels are one, else it would be too large" if page.binned > 1 else ""
    print(f"{path}: {len(page.html) / 1e6:.1f} MB{pixels}")
    if not made.met:
        raise ToleranceNotMet("the tolerance was not met; this is the best image that was found")
    return 0


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    return {"tolerance": arguments.tolerance, "seed": arguments.seed, **shared.tracer_options(arguments)}


def _words(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Words of the command that makes the same basis, without its folder."""
    words = ["radwrap", "render", arguments.scene, *(word for text in arguments.overrides for word in ("--set", text))]
    if arguments.scale is not None:
        words += ["--scale", arguments.scale]
    if arguments.roi is not None:
        words += ["--roi", *map(str, arguments.roi)]
    if arguments.tolerance is not None:
        words += ["--tolerance", str(arguments.tolerance)]
    if arguments.seed:
        words += ["--seed", str(arguments.seed)]
    for name in ("tracer", "radiance"):
        if getattr(arguments, name) not in (None, "auto"):
            words += [f"--{name}", getattr(arguments, name)]
    return (*words, *(["--trust"] if arguments.trust else []), "--basis")


def _words_for_others(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The same for a page that others read: the scene by its name alone; none where another word names a place."""
    if any(_PLACE.search(text) for text in (*arguments.overrides, f"={arguments.radiance or ''}")):
        return ()
    given = argparse.Namespace(**{**vars(arguments), "scene": Path(arguments.scene).name})
    return _words(given)


def _unusual(options: dict[str, Any]) -> dict[str, Any]:
    """Those that decide the picture and are not as usual; how long a tracer may be silent does not."""
    usual = RenderOptions()
    named = ("tolerance", "seed", "tracer", "radiance", "trust")
    return {name: options[name] for name in named if name in options and options[name] != getattr(usual, name)}


def _has_screen() -> bool:
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _open(page: Path) -> None:
    """Open a file in the user's browser: its name may be seen by all users of the machine, the link in it may not."""
    with suppress(webbrowser.Error, OSError):
        webbrowser.open(page.as_uri())
