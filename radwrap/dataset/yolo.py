"""Labels of YOLO: a text file an image, a line an object, as shares of the image's size."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

LABELS: Final = "labels"
DATA: Final = "data.yaml"


def label_text(record: Mapping[str, Any]) -> str:
    """``class centre_x centre_y width height`` of each object that is seen; classes count from 0.

    Shares are of the image's width and height, from its upper left corner: pixel 0 reaches from 0 to 1.
    """
    lines = []
    for one in record["objects"]:
        x, y, width, height = one["bbox_visib"]
        if one["px_count_visib"]:
            columns, rows = record["width"], record["height"]
            shares = (x + width / 2) / columns, (y + height / 2) / rows, width / columns, height / rows
            lines.append(f"{one['obj_id'] - 1} {' '.join(f'{share:.9g}' for share in shares)}\n")
    return "".join(lines)


def data_text(folders: Iterable[str], categories: Sequence[str]) -> str:
    """The file that names folders of images and classes; strings of JSON are strings of YAML."""
    rows = [f"  - {json.dumps(folder)}" for folder in folders]
    names = [f"  {number}: {json.dumps(name)}" for number, name in enumerate(categories)]
    return "\n".join(["train:", *rows, "val: []", "names:", *names]) + "\n"
