"""COCO's annotations: images, categories, and for each object its box, area and mask as run lengths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from radwrap.dataset.first_hits import ImageTruth
from radwrap.dataset.outlines import polygons
from radwrap.dataset.run_lengths import segmentation
from radwrap.dataset.tables import SegmentationName

COCO_FILE: Final = "coco.json"
_OBJECTS: Final = 10_000  # of one image at most, so that numbers of annotations hang on the image alone


def annotations_of(
    truth: ImageTruth, categories: Mapping[str, int], image: int, kind: SegmentationName = "rle"
) -> list[dict[str, Any]]:
    """Annotations of what is seen in an image.

    Parameters
    ----------
    truth : ImageTruth
        What is true of it.
    categories : Mapping of str to int
        Name of each object -> number of its category, from 1.
    image : int
        Its number.
    kind : str
        How masks are held: "rle", run lengths, or "polygons".

    Returns
    -------
    list of dict
        ``bbox`` and ``area`` are of the visible pixels; ``visible_share`` and ``bbox_whole`` are ours. Objects of which
        nothing is seen are left out.
    """
    found = []
    for number, one in enumerate(truth.objects, 1):
        if not one.visible_pixels:
            continue
        found.append(
            {
                "id": image * _OBJECTS + number,
                "image_id": image,
                "category_id": categories[one.part.name],
                "bbox": one.visible_box.values,
                "area": one.visible_pixels,
                "iscrowd": 0,
                "segmentation": polygons(one.visible) if kind == "polygons" else segmentation(one.visible),
                "bbox_whole": one.whole_box.values,
                "visible_share": one.visible_share,
                "name": one.part.name,
            }
        )
    return found


def coco_file(title: str, categories: Sequence[str], records: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """The file of a shard, from the records of its images."""
    images: list[dict[str, Any]] = []
    found: list[dict[str, Any]] = []
    for record in records:
        images.append(
            {
                "id": record["image"],
                "file_name": record["gray"],
                "width": record["width"],
                "height": record["height"],
            }
        )
        found += record["coco"]
    return {
        "info": {"description": title},
        "licenses": [],
        "images": images,
        "annotations": found,
        "categories": [{"id": number, "name": name} for number, name in enumerate(categories, 1)],
    }
