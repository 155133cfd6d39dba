"""A sheet under three rings of the catalog; the levels of two are assumed, that of the right one is given."""

from __future__ import annotations

from typing import Any


def three_rings(rows: int, columns: int, exposure_time: str, **ring: Any) -> dict[str, Any]:
    """The scene's document."""
    each = {"type": "ring", "preset": "generic_ring_60mm_16led", "look_at": ["0 mm", "0 mm", "0 mm"], **ring}
    return {
        "camera": {
            "position": ["0 mm", "0 mm", "400 mm"],
            "look_at": ["0 mm", "0 mm", "0 mm"],
            "focal_length": "12.5 mm",
            "exposure_time": exposure_time,
            "diffraction": "off",
            "aperture": {"diameter": "0.5 mm"},
            "sensor": {
                **{"preset": "sony_imx250.lucid_atlas", "rows": rows, "columns": columns},
                **{"pixel_width": "40 um", "pixel_height": "40 um"},
                **{"full_well": "1000 ke", "system_gain": "0.003 DN/e"},
            },
        },
        "sources": [
            each | {"name": "left", "position": ["-60 mm", "0 mm", "300 mm"]},
            each | {"name": "right", "position": ["80 mm", "0 mm", "300 mm"], "radiant_intensity": "20 mW/sr"},
            each | {"name": "far", "position": ["0 mm", "90 mm", "350 mm"]},
        ],
        "materials": {"grey": {"type": "lambertian", "reflectance": 0.3}},
        "targets": [{"type": "sheet", "name": "sheet", "material": "grey", "size": ["300 mm", "300 mm"]}],
    }
