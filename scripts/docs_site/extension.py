"""Makes pages before Sphinx reads them: tutorials are run, reference and gallery follow from code and scenes."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from docs_site import gallery, lessons, pictures, reference

GENERATED: Final = "generated"
TUTORIALS: Final = "tutorials/"
_AFTER_THEME: Final = 900  # furo makes the navigation at 500


def _write(folder: Path, pages: Iterable[tuple[str, str]]) -> None:
    """Write pages whose text has changed; others keep their time, so that Sphinx does not read them again."""
    there = set()
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in pages:
        file = folder / f"{name}.md"
        there.add(file)
        if not file.is_file() or file.read_text("utf-8") != text:
            file.write_text(text, "utf-8")
    for file in set(folder.glob("*.md")) - there:
        file.unlink()


def make_pages(app: Any) -> None:
    """Write reference and gallery into docs/generated."""
    from radwrap.cli.main import whole_parser
    from radwrap.scene.file.described import described_schema

    source = Path(app.srcdir)
    made = source / GENERATED
    _write(made / "cli", reference.verb_pages(whole_parser()))
    _write(made / "scene", reference.scene_pages(described_schema()))
    cache = source.parent / "out" / "gallery"
    _write(made / "gallery", gallery.pages(source.parent / "rad_scenes", cache, made / "gallery"))


def run_tutorial(app: Any, name: str, source: list[str]) -> None:
    """Replace a tutorial by the same with what it prints."""
    if not name.startswith(TUTORIALS):
        return
    place = Path(app.srcdir) / GENERATED / name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    with tempfile.TemporaryDirectory(prefix="radwrap-lesson-") as folder:
        done = lessons.run(source[0], Path(folder), f"{name}.md")
        for picture in Path(folder).glob("*.png"):
            pictures.shown(picture, place / picture.name)
    notebook = place / f"{Path(name).name}.ipynb"
    notebook.write_text(lessons.as_notebook(done), "utf-8")
    here = f"/{GENERATED}/{name}"
    source[0] = lessons.page(done, here, f"{here}/{notebook.name}")


def make_accessible(_app: Any, _page: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
    """Let the keyboard scroll wide code, and say at which level captions of the navigation stand."""
    context["body"] = context.get("body", "").replace("<pre>", '<pre tabindex="0">')
    navigation = context.get("furo_navigation_tree", "")
    context["furo_navigation_tree"] = navigation.replace('role="heading"', 'role="heading" aria-level="2"')


def setup(app: Any) -> dict[str, bool]:
    """Register what is made when."""
    app.connect("builder-inited", make_pages)
    app.connect("source-read", run_tutorial)
    app.connect("html-page-context", make_accessible, priority=_AFTER_THEME)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
