"""The page as one file: small, closed, and what it holds is what was rendered."""

from __future__ import annotations

import base64
import getpass
import hashlib
import json
import re
import socket
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

import radwrap
from radwrap.errors import InputError
from radwrap.imaging.page.bundle import script_of
from radwrap.imaging.page.one_file import LARGEST, Page, one_file
from radwrap.imaging.relight.relit import Basis, read_basis, relit
from tests.cli.conftest import inside, scene_with, write_scene
from tests.face.conftest import HOSTILE_TITLE, TWO

HOSTILE: Final = {**TWO, "title": HOSTILE_TITLE + "<!-- <script> \u2028 ]]>"}


class Elements(HTMLParser):
    """Elements that have contents or load something, as a browser's parser finds them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None], str]] = []
        self.inside = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs), ""))
        self.inside = True

    def handle_endtag(self, tag: str) -> None:
        self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            tag, attributes, content = self.found[-1]
            self.found[-1] = (tag, attributes, content + data)

    def each(self, tag: str) -> list[tuple[dict[str, str | None], str]]:
        return [(attributes, content) for name, attributes, content in self.found if name == tag]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[radwrap.Rendered, Page, Basis]:
    out = tmp_path_factory.mktemp("export")
    result = radwrap.render(radwrap.scene_from_document(scene_with(HOSTILE)), out, basis=True, tolerance=2)
    return result, result.page(), read_basis(out)


Made = tuple[radwrap.Rendered, Page, Basis]


def held(page: Page) -> Any:
    (content,) = [
        content for attributes, content in Elements(page.html).each("script") if attributes.get("id") == "data"
    ]
    return json.loads(content)


def numbers(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_only_its_own_scripts_run(made: Made) -> None:
    """Each script and style that runs is in the policy by its hash; nothing may be loaded or asked for."""
    page = Elements(made[1].html)
    (policy,) = [a["content"] or "" for a, _ in page.each("meta") if a.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'" and "connect-src" not in rules
    running = [content for attributes, content in page.each("script") if "type" not in attributes]
    styles = [content for _, content in page.each("style")]
    assert len(running) == 2 and len(styles) == 1
    for kind, contents in (("script-src", running), ("style-src", styles)):
        known = {f"'sha256-{base64.b64encode(hashlib.sha256(one.encode()).digest()).decode()}'" for one in contents}
        assert set(rules[kind].split()) == known
    assert not page.each("link") and not page.each("img") and not page.each("iframe")
    assert all("src" not in attributes for _, attributes, _ in page.found)
    assert all(not name.startswith("on") and name != "style" for _, attributes, _ in page.found for name in attributes)


def test_a_hostile_title_stays_in_the_data(made: Made) -> None:
    page = Elements(made[1].html)
    assert [attributes.get("id") for attributes, _ in page.each("script")] == ["worker", "data", None, None]
    assert held(made[1])["described"]["title"] == HOSTILE["title"]
    assert HOSTILE_TITLE not in made[1].html


def test_it_holds_what_was_rendered(made: Made) -> None:
    result, page, basis = made
    data = held(page)
    exposure = numbers(data["exposure"]).reshape(20, 24)
    (image,) = relit(basis, [[1.0, 1.0]])
    assert np.array_equal(exposure, image.radiant_exposure.values)
    codes = data["told"]["thresholds"]["first"] + np.searchsorted(numbers(data["values"]), exposure, side="right")
    assert np.array_equal(codes, result.gray.codes)
    for plane, parts in zip(data["planes"], basis.images, strict=True):
        assert np.array_equal(numbers(plane).reshape(20, 24), parts.mean(axis=0, dtype=np.float64).astype(np.float32))
    assert data["described"]["binned"] == page.binned == 1
    assert data["told"]["error"]["rms_gray_upper95"] > 0


def test_it_says_nothing_of_the_machine(made: Made, tmp_path: Path) -> None:
    for word in (str(tmp_path.parent.parent), "/dev/shm", "/tmp", "/home", "/root"):  # noqa: S108
        assert word not in made[1].html, word
    told = {key: value for key, value in held(made[1]).items() if key in ("described", "told")}
    for word in (socket.gethostname(), getpass.getuser()):
        assert not re.search(rf"\b{re.escape(word)}\b", json.dumps(told)), word


def test_a_large_one_is_binned_to_fit(made: Made) -> None:
    """Twelve times as many sources, at 200 x 240 pixels: means of blocks, and the file keeps its limit."""
    result, _, basis = made
    sensor = replace(basis.sensor, rows=200, columns=241)
    rng = np.random.default_rng(3)
    images = rng.random((24, 2, 200, 241)).astype(np.float32)
    names = tuple(f"lamp{k}" for k in range(24))
    large = replace(
        basis,
        images=images,
        sources=names,
        camera=replace(basis.camera, sensor=sensor),
        sample=None,
        grid=np.zeros((24, 2, 0), dtype=np.float32),
        grid_pixels=np.zeros(0, dtype=np.intp),
        lacks=np.zeros((24, 2, 0), dtype=np.float32),
    )
    page = one_file(result.scene, large, result.run)
    assert page.binned == 2 and len(page.html.encode()) <= LARGEST and "2 x 2 pixels are one" in repr(page)
    data = held(page)
    assert (data["described"]["rows"], data["described"]["columns"]) == (100, 121)
    plane = images[5].mean(axis=0, dtype=np.float64)
    mean = numbers(data["planes"][5]).reshape(100, 121)
    assert mean[7, 9] == pytest.approx(plane[14:16, 18:20].mean(), rel=1e-6)
    assert mean[7, 120] == pytest.approx(plane[14:16, 240].mean(), rel=1e-6)
    assert mean.mean() == pytest.approx(plane.mean(), rel=1e-2)


def test_a_notebook_shows_it_in_a_frame_that_can_do_nothing_else(made: Made) -> None:
    shown = made[1]._repr_html_()
    ((frame, _),) = Elements(shown).each("iframe")
    assert frame["sandbox"] == "allow-scripts allow-downloads" and frame["srcdoc"] == made[1].html
    assert made[0]._repr_png_().startswith(b"\x89PNG")


def test_without_a_basis_there_is_no_page() -> None:
    result = radwrap.render(radwrap.scene_from_document(scene_with(TWO)), tolerance=8)
    with pytest.raises(InputError, match="needs a light basis"):
        result.page()


def test_a_bundle_is_one_script_without_imports() -> None:
    for name in ("exported.js", "worker.js"):
        script = script_of(name)
        assert not re.search(r"^\s*(import|export)\b", script, re.MULTILINE)
        assert "</script" not in script.lower() and "<!--" not in script
        assert script.count("modules[") > 1 and 'modules["types.js"]' not in script


def test_the_command_of_a_page_is_that_of_its_picture(made: Made, tmp_path: Path) -> None:
    """With what was set, and without places of this machine."""
    assert held(made[1])["told"]["command"] == ""  # this scene came from no file
    scene, page = write_scene(tmp_path, TWO), tmp_path / "page.html"
    result, _, basis = made
    kept = one_file(radwrap.load_scene(scene), basis, result.run)
    assert held(kept)["told"]["command"].startswith("radwrap render scene.toml --tolerance 2.0 --basis --out basis && ")
    options = ("--tolerance", 2, "--tracer", "radiance", "--seed", 3)
    for more, told in (
        (
            ("--set", "camera.exposure_time=200 ms"),
            "radwrap render scene.toml --set 'camera.exposure_time=200 ms' --tolerance 2",
        ),
        (("--set", "title=/home/me", "--set", "sources[0].radiance=90 kW/m^2/sr"), ""),
    ):
        inside("face", scene, *more, *options, "--export", page).success()
        (content,) = [text for given, text in Elements(page.read_text()).each("script") if given.get("id") == "data"]
        assert json.loads(content)["told"]["command"].startswith(told) and (
            told or not json.loads(content)["told"]["command"]
        )
