"""A dataset's file: what it says, what is refused with its key, and what an image's draws hang on."""

from __future__ import annotations

import json

import numpy as np
import pytest

from radwrap.dataset.document import Dataset, read_dataset
from radwrap.dataset.drawn import MOST_TRIES, drawn_image
from radwrap.errors import InputError
from tests.dataset.conftest import Write

WHOLE = """
images = 5
seed = 7

[[vary]]
key = "camera.exposure_time"
log_uniform = ["50 ms", "200 ms"]

[[vary]]
key = "sources[0].leds[*].radiance_factor"
normal = [1.0, 0.05]

[[vary]]
key = "materials.grey.reflectance"
choice = [0.2, 0.5]

[[parts]]
target = "block"
count = [0, 3]
x = ["-20 mm", "20 mm"]
y = ["-20 mm", "20 mm"]
z = "2 mm"
"""


@pytest.fixture
def dataset(dataset_file: Write) -> Dataset:
    return read_dataset(dataset_file(WHOLE))


def test_defaults(dataset_file: Write) -> None:
    found = read_dataset(dataset_file("images = 1"))
    assert (found.seed, found.shard, found.tolerance, found.formats) == (0, 1000, 1, ("coco",))
    assert found.categories == ("block",)


def test_draws_hang_on_seed_and_number_alone(dataset: Dataset) -> None:
    forwards = [drawn_image(dataset, number) for number in range(5)]
    backwards = [drawn_image(dataset, number) for number in reversed(range(5))]
    assert forwards == backwards[::-1]
    texts = {json.dumps(one.document, sort_keys=True) for one in forwards}
    assert len(texts) == 5 and len({one.seed for one in forwards}) == 5


def test_each_led_has_its_own_draw(dataset: Dataset) -> None:
    leds = drawn_image(dataset, 0).document["sources"][0]["leds"]
    assert len({led["radiance_factor"] for led in leds}) == len(leds) == 4


def test_every_count_is_as_likely(dataset: Dataset) -> None:
    """Chi squared of 400 images over four counts: 3 degrees of freedom, 1e-6 of them lie beyond 30.7."""
    counts = [len(drawn_image(dataset, number).categories) for number in range(400)]
    found = np.bincount(counts, minlength=4)
    assert len(found) == 4
    assert ((found - 100.0) ** 2 / 100).sum() < 30.7


def test_copies_have_names_a_category_and_their_place(dataset: Dataset) -> None:
    image = next(one for number in range(50) if len((one := drawn_image(dataset, number)).categories) == 3)
    assert dict(image.categories) == {f"block_{number}": "block" for number in (1, 2, 3)}
    assert [target["name"] for target in image.document["targets"]] == ["table", *image.categories]
    for target in image.document["targets"][1:]:
        assert target["position"][2] == "2 mm"
        assert abs(float(target["position"][0].split()[0])) <= 20


def test_a_part_without_a_place_ends_after_a_thousand_tries(dataset_file: Write) -> None:
    crowded = read_dataset(dataset_file('images = 1\n[[parts]]\ntarget = "block"'))
    asked = []
    with pytest.raises(InputError, match="no place in 1000 tries") as told:
        drawn_image(crowded, 0, lambda table, category: bool(asked.append((table, category))))
    assert len(asked) == MOST_TRIES
    assert told.value.where == "dataset.toml: parts[0]"


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "images"),
        ("images = 0", "images"),
        ("images = 1\nseed = -1", "seed"),
        ('images = 1\nformats = ["voc"]', "formats[0]"),
        ("images = 1\nformats = []", "formats"),
        (
            'images = 1\nformats = ["bop"]\n[set]\n"camera.distortion" = { model = "opencv", k1 = 0.1 }',
            "formats",
        ),
        ('images = 1\n[[vary]]\nkey = "targets[1].length_unit"\nchoice = ["1 mm"]', "vary[0].key"),
        ('images = 1\nformats = ["coco", "coco"]', "formats"),
        ("images = 1\ntolerance = -1", "tolerance"),
        ('images = 1\ntolerance = "much"', "tolerance"),
        ("images = 1\nshards = 4", "shards"),
        ("images = 1\nnoise = true", "noise"),
        ('images = 1\n[[vary]]\nkey = "camera.exposure_time"', "vary[0]"),
        ('images = 1\n[[vary]]\nkey = "camera.exposure_time"\nuniform = [1, 2]', "vary[0]"),
        ('images = 1\n[[vary]]\nkey = "camera.exposure"\nuniform = ["1 ms", "2 ms"]', "vary[0]"),
        ('images = 1\n[[vary]]\nkey = "targets[9].position"\nchoice = [1]', "vary[0]"),
        ('images = 1\n[[vary]]\nkey = "materials.grey.reflectance"\nuniform = [0.5, 1.5]', "vary[0]"),
        ('images = 1\n[[vary]]\nkey = "targets[1].position"\nrotation = "any"', "vary[0].key"),
        ('images = 1\n[[vary]]\nkey = "camera.exposure_time"\nuniform = ["1 ms", "2 ms"]\nweights = [1]', "vary[0]"),
        ('images = 1\n[[parts]]\ntarget = "nut"', "parts[0].target"),
        ('images = 1\n[[parts]]\ntarget = "table"', "parts[0].target"),
        ('images = 1\n[[parts]]\ntarget = "block"\ncount = [3, 1]', "parts[0].count"),
        ('images = 1\n[[parts]]\ntarget = "block"\ncount = 1.5', "parts[0].count"),
        ('images = 1\n[[parts]]\ntarget = "block"\nx = 3', "parts[0].x"),
        ('images = 1\n[[parts]]\ntarget = "block"\nx = "3 s"', "parts[0]"),
        ('images = 1\n[[parts]]\ntarget = "block"\nrotation = "none"', "parts[0].rotation"),
        (
            'images = 1\n[[parts]]\ntarget = "block"\n[[vary]]\nkey = "targets[1].rotation"\nrotation = "any"',
            "vary[0].key",
        ),
        (
            'images = 1\n[[vary]]\nkey = "targets[1].rotation"\nrotation = "any"\n'
            '[[vary]]\nkey = "targets[*].rotation"\nrotation = "any"',
            "vary[1].key",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_key(dataset_file: Write, text: str, where: str) -> None:
    with pytest.raises(InputError) as told:
        read_dataset(dataset_file(text))
    assert told.value.where == f"dataset.toml: {where}"


def test_of_a_misspelt_material_the_one_that_there_is_is_named(dataset_file: Write) -> None:
    """A key path makes the tables on its way: what is missing then is the type of a material that nobody wanted."""
    text = 'images = 1\n[[vary]]\nkey = "materials.gray.reflectance"\nuniform = [0.5, 0.6]'
    with pytest.raises(InputError) as refused:
        read_dataset(dataset_file(text))
    assert str(refused.value) == (
        'dataset.toml: vary[0]: scene.toml: materials.gray.type: is missing; give "gray" one; did you mean "grey"?'
    )
