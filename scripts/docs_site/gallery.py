"""A page for each scene of rad_scenes: its picture, its error, its command, and the live page where one is possible."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2

import radwrap
from docs_site.pictures import for_eyes
from radwrap.errors import RadwrapError
from radwrap.scene.scene import Scene

# A picture of the gallery has so many pixels at most; larger sensors are read out with larger pixels.
MOST_PIXELS: Final = 200_000
_MADE: Final = "made.json"
# Scenes that show nothing without an option; their files say so.
OPTIONS: Final[dict[str, dict[str, Any]]] = {"white_tent": {"bounces": "all", "tolerance": 8.0}}
TOGETHER: Final = ("crosscheck",)  # folders whose scenes share a page


@dataclass(frozen=True, slots=True)
class Exhibit:
    """What the gallery shows of a scene.

    Attributes
    ----------
    name : str
        Folder of the scene under rad_scenes.
    title : str
        As the scene has it.
    scale : int
        One pixel of the picture stands for so many in each direction.
    facts : dict
        From the manifest.
    live : str
        Why there is no live page; empty where there is one.
    """

    name: str
    title: str
    scale: int
    facts: dict[str, str]
    live: str


def scenes(folder: Path) -> list[Path]:
    """Scene files under a folder, in order of their names."""
    return sorted(folder.rglob("scene.toml"))


def shown(path: Path, name: str, there: Path) -> Exhibit:
    """Picture and live page of a scene in a folder, rendered where that does not have them.

    Parameters
    ----------
    path : path
        Scene file.
    name : str
        Of the scene.
    there : path
        Folder for this state of scene and package, see `_key`.
    """
    if not (there / _MADE).is_file():
        made = _made(path, name, there)
        (there / _MADE).write_text(json.dumps(made, indent=1))
    return Exhibit(name, **json.loads((there / _MADE).read_text()))


def _hashed(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        if file.is_file() and file.suffix != ".png":
            digest.update(file.read_bytes())
    return digest.hexdigest()[:24]


def _package() -> str:
    """Hash of what makes exhibits: radwrap's own modules, and this one."""
    return _hashed((*sorted(Path(radwrap.__file__).parent.rglob("*.py")), Path(__file__)))


def _key(path: Path, package: str) -> str:
    """Name for all that an exhibit hangs on: the files of the scene's folder, and the package."""
    return f"{_hashed(sorted(path.parent.iterdir()))}-{package}"


def _scaled(scene: Scene, path: Path) -> tuple[Scene, int]:
    """The scene with pixels large enough."""
    scale = max(1, math.ceil(math.sqrt(scene.camera.sensor.pixels / MOST_PIXELS)))
    if scale == 1:
        return scene, 1
    return radwrap.load_scene(path, {"camera.sensor.scale": f"1/{scale}"}), scale


def _made(path: Path, name: str, there: Path) -> dict[str, object]:
    there.mkdir(parents=True, exist_ok=True)
    scene, scale = _scaled(radwrap.load_scene(path), path)
    options = OPTIONS.get(name, {})
    result = radwrap.render(scene, there / "out", **options)
    cv2.imwrite(str(there / "gray.png"), for_eyes(result.gray.values, scene.camera.sensor.saturation_gray))
    error = result.error
    facts = {
        "pixels": f"{scene.camera.sensor.columns} x {scene.camera.sensor.rows}",
        "method": str(result.manifest["method"]),
        "rays": f"{result.manifest['rays']:,}",
        "tolerance": f"{result.manifest['tolerance']:g} gray levels rms" if result.manifest["tolerance"] else "none",
        "error": f"below {error.rms_gray_upper95:.2g} gray levels rms (95 %)" if error else "not measured",
        "left out": "; ".join(f"{what}: {one.rms_gray:.2g}" for what, one in result.left_out.items()) or "nothing",
        "time": f"{result.manifest['timing']['wall_s']:.1f} s on the machine that made this page",
    }
    try:
        radwrap.render(scene, there / "basis", basis=True, **options).page().save(there / "page.html")
        live = ""
    except RadwrapError as error_of_basis:
        live = str(error_of_basis)
    for folder in ("out", "basis"):
        shutil.rmtree(there / folder, ignore_errors=True)
    return {
        "title": tomllib.loads(path.read_text("utf-8")).get("title", name),
        "scale": scale,
        "facts": facts,
        "live": live,
    }


def pages(home: Path, cache: Path, pictures: Path) -> Iterator[tuple[str, str]]:
    """Name and MyST text of each page of the gallery, first its overview; pictures and live pages go beside them.

    Parameters
    ----------
    home : path
        Folder of all scenes.
    cache : path
        What was rendered already.
    pictures : path
        Folder of the pages.
    """
    exhibits, package = [], _package()
    for path in scenes(home):
        there = cache / _key(path, package)
        exhibit = shown(path, path.parent.relative_to(home).as_posix(), there)
        exhibits.append(exhibit)
        for ending in (".png", ".html"):
            for file in there.glob(f"*{ending}"):
                pictures.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, pictures / f"{_page(exhibit.name)}{ending}")
    together: dict[str, list[Exhibit]] = {}
    for exhibit in exhibits:
        group = exhibit.name.split("/")[0]
        together.setdefault(group if group in TOGETHER else _page(exhibit.name), []).append(exhibit)
    yield "index", _overview(together)
    for page, some in together.items():
        yield page, "\n".join([f"# {page}", "", *(_text(exhibit, len(some) > 1) for exhibit in some)])


def _page(name: str) -> str:
    return name.replace("/", "-")


def _text(exhibit: Exhibit, one_of_several: bool) -> str:
    command = f"radwrap render rad_scenes/{exhibit.name}/scene.toml --out out"
    if exhibit.scale > 1:
        command += f" --scale 1/{exhibit.scale}"
    command += "".join(f" --{option} {value}" for option, value in OPTIONS.get(exhibit.name, {}).items())
    rows = "\n".join(f"| {what} | {told} |" for what, told in exhibit.facts.items())
    name = _page(exhibit.name)
    live = (
        f"{{download}}`The live page <{name}.html>` mixes its light, exposure and sensor in the browser."
        if not exhibit.live
        else f"There is no live page: {exhibit.live}"
    )
    heading = f"## {exhibit.name.split('/')[-1]}\n\n" if one_of_several else ""
    return f"""{heading}{exhibit.title[:1].upper()}{exhibit.title[1:]}.

![predicted gray image of {exhibit.name}]({name}.png)

    {command}

| what | value |
|---|---|
{rows}

{live}
"""


def _overview(together: dict[str, list[Exhibit]]) -> str:
    rows = "\n".join(
        f"| [{one.name}]({page}.md) | {one.title} | {one.facts['error']} |"
        for page, some in together.items()
        for one in some
    )
    toc = "\n".join(together)
    return f"""# Gallery

Every scene of `rad_scenes`, rendered to its tolerance.

| scene | what it shows | error |
|---|---|---|
{rows}

```{{toctree}}
:hidden:

{toc}
```
"""
