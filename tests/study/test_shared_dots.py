"""Dots of an image are sought once for all its responses, and come out as if each had sought them alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import radwrap
from radwrap.images import GrayImage
from radwrap.imaging.response.sensor import gray_levels
from radwrap.measure.dots import METHODS, Dots, Method, SoughtDots, find_dots, measured_dots
from radwrap.scene.targets import DotBoard
from radwrap.study import responses
from radwrap.study.image_error import blur_radii, error_fields, image_error
from radwrap.study.responses import Response, answer
from radwrap.study.seen import Seen

SCENE = Path(__file__).parents[2] / "rad_scenes" / "bench_board" / "scene.toml"


@pytest.fixture(scope="module")
def seen() -> Seen:
    scene = radwrap.load_scene(SCENE, {"camera.aperture.diameter": "0.2 mm", "camera.exposure_time": "100 ms"})
    result = radwrap.render(scene, tolerance=0.5)
    gray = gray_levels(result.radiant_exposure.values, scene.camera.sensor)
    radii = blur_radii(scene)
    fields = error_fields(gray.shape, radii, 0)
    return Seen(scene, result.gray, gray, image_error(gray, 0.5, radii), fields)


@pytest.mark.parametrize("methods", [("gray", "conic"), pytest.param(METHODS, marks=pytest.mark.long)], ids=len)
def test_every_method_answers_as_alone_and_seeks_once(
    seen: Seen, monkeypatch: pytest.MonkeyPatch, methods: tuple[str, ...]
) -> None:
    asked: list[object] = []
    seek = responses.seek_dots

    def counted(image: GrayImage, *arguments: int, **options: object) -> object:
        asked.append(image)
        return seek(image, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(responses, "seek_dots", counted)
    seen.sought.clear()
    answers = {
        method: answer(Response("f", "focal_length", "mm", {"method": method, "draws": 4}), seen) for method in methods
    }
    assert asked == [seen.image]
    assert len({found.value for found in answers.values()}) == len(methods)
    board = next(target for target in seen.scene.targets if isinstance(target, DotBoard))
    alone = find_dots(
        seen.image,
        5,
        5,
        method="conic",
        pitch=board.pitch,
        dot_diameter=board.dot_diameter,
        saturation=seen.scene.camera.sensor.saturation_gray,
    )
    shared = measured_dots(seen.sought[0, board.name, None], "conic")
    assert np.array_equal(shared.centres, alone.centres)


def test_a_failing_method_leaves_the_others(seen: Seen, monkeypatch: pytest.MonkeyPatch) -> None:
    by_gray = Response("f", "focal_length", "mm", {"method": "gray", "draws": 4})
    alone = answer(by_gray, seen)
    measure = responses.measured_dots

    def without_conic(sought: SoughtDots, method: Method) -> Dots:
        if method == "conic":
            raise radwrap.InputError("no conic today")
        return measure(sought, method)

    monkeypatch.setattr(responses, "measured_dots", without_conic)
    seen.sought.clear()
    with pytest.raises(radwrap.InputError, match="no conic today"):
        answer(Response("f", "focal_length", "mm", {"method": "conic", "draws": 4}), seen)
    assert answer(by_gray, seen) == alone


@pytest.mark.long
@pytest.mark.parametrize(
    ("rms", "methods"),
    [
        (0.5, ("conic",)),
        (0.0, ("gray",)),
        (0.5, METHODS),
    ],
)
def test_an_image_that_is_not_rounded_has_an_error_too(seen: Seen, rms: float, methods: tuple[str, ...]) -> None:
    scene = radwrap.with_value(seen.scene, "camera.sensor.rounding", False)
    error = image_error(seen.gray, rms, blur_radii(scene))
    plain = Seen(scene, GrayImage(seen.gray, seen.image.bit_depth), seen.gray, error, seen.fields)
    for method in methods:
        response = Response("f", "focal_length", "mm", {"method": method, "draws": 12})
        rounded, found = answer(response, seen), answer(response, plain)
        # Rounding moves f by less than the image's error may; the errors are alike, for the images are.
        assert found.value == pytest.approx(rounded.value, abs=3 * rounded.error)
        assert found.error == (pytest.approx(rounded.error, rel=1.0) if rms else pytest.approx(0, abs=1e-9))


@pytest.mark.parametrize("draws", [3, 6.5, -1])
def test_too_few_draws_are_refused(draws: float) -> None:
    with pytest.raises(radwrap.InputError, match=r"study\.toml: responses\.f\.draws"):
        responses.check_options("focal_length", {"draws": draws}, "study.toml: responses.f")
