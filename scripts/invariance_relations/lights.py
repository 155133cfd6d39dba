"""Random light sources of all kinds, each of about the same irradiance at the origin."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from invariance_relations.documents import WIDE, Table, length, lengths

_POINTLIKE: Final = ("led", "lamp", "disc", "ies", "ring")
_WIDE_SHARE: Final = 0.2  # of the scenes
_WIDE_CHANCES: Final = (0.3, 0.25, 0.1, 0.25, 0.1)  # domes and surrounds take the most patches
# Irradiance error of wide sources, coarse so that many scenes can be seen; at 0.05 what shines from all around takes
# hundreds of patches, at this one some 60.
_ASKED: Final = 0.05
_ASKED_AROUND: Final = 0.15


def draw_sources(random: np.random.Generator, distance: float, seen: float, files: dict[str, bytes]) -> list[Table]:
    """One to three sources about the camera, not in its view."""
    if random.random() < _WIDE_SHARE:
        kinds = [str(random.choice(WIDE, p=_WIDE_CHANCES))]
        if kinds[0] not in ("coaxial", "dome") and random.random() < 0.5:
            kinds.append(str(random.choice(_POINTLIKE)))
    else:
        kinds = [str(kind) for kind in random.choice(_POINTLIKE, int(random.integers(1, 4)))]
    files["beam.csv"] = b"angle_deg,relative_intensity\n0,1\n5,0.95\n15,0.7\n30,0.3\n50,0.05\n70,0\n"
    files["lamp.ies"] = ies_text(
        np.arange(0.0, 91.0, 15.0),
        np.arange(0.0, 361.0, 45.0),
        np.array(
            [
                100 * (1 + 0.3 * math.sin(math.radians(h)) * math.sin(math.radians(v))) * math.cos(math.radians(v))
                for h in np.arange(0.0, 361.0, 45.0)
                for v in np.arange(0.0, 91.0, 15.0)
            ]
        ).reshape(9, 7),
    )
    return [_source(kind, f"light{n}", distance, seen, random) for n, kind in enumerate(kinds)]


def ies_text(
    vertical: np.ndarray[tuple[int], np.dtype[np.float64]],
    horizontal: np.ndarray[tuple[int], np.dtype[np.float64]],
    candela: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> bytes:
    """A luminaire as LM-63, candela in rows of one horizontal angle each."""
    rows = [" ".join(repr(float(value)) for value in row) for row in (vertical, horizontal, *candela)]
    head = ["IESNA:LM-63-2002", "TILT=NONE", f"1 -1 1 {len(vertical)} {len(horizontal)} 1 2 0 0 0", "1 1 50"]
    return "\n".join([*head, *rows, ""]).encode()


def _beam(random: np.random.Generator) -> Table:
    kind = str(random.choice(["gaussian", "cosine_power", "cone", "lambertian", "table"]))
    if kind == "lambertian":
        return {"profile": kind}
    if kind == "table":
        return {"profile": kind, "file": "beam.csv"}
    beam: Table = {"profile": kind, "width": f"{random.uniform(20, 70):.3f} deg"}
    if kind != "cone" and random.random() < 0.5:
        beam["width_definition"] = str(random.choice(["fwhm", "half_angle"]))
    return beam


def _source(kind: str, name: str, distance: float, seen: float, random: np.random.Generator) -> Table:
    """One source; W/m^2/sr and W/sr are such that each gives some W/m^2 where the camera looks."""
    table: Table = {"type": kind, "name": name}
    strength = random.uniform(1, 4)  # W/m^2 at the origin, about
    if kind == "surround":
        return table | {"radiance": f"{strength / math.pi:.6g} W/m^2/sr", "irradiance_error": _ASKED_AROUND}
    if kind == "coaxial":
        way, diameter = distance * random.uniform(0.3, 0.8), distance * random.uniform(0.1, 0.3)
        level = strength * (distance + way) ** 2 / (math.pi / 4 * diameter**2)
        return table | {
            "radiance": f"{4 * level:.6g} W/m^2/sr",
            "diameter": length(diameter),
            "distance": length(way),
            "irradiance_error": _ASKED,
        }
    if kind == "dome":
        radius = distance * random.uniform(0.6, 0.9)
        return table | {
            "position": ["0 mm", "0 mm", "0 mm"],
            "look_at": lengths((0, 0, -distance)),
            "radiance": f"{strength / math.pi:.6g} W/m^2/sr",
            "diameter": length(2 * radius),
            "opening_diameter": length(2 * seen + 0.05 * distance),
            "irradiance_error": _ASKED_AROUND,
        }
    return table | _aimed(kind, strength, distance, seen, random)


def _aimed(kind: str, strength: float, distance: float, seen: float, random: np.random.Generator) -> Table:
    """Sources that stand somewhere and look at something."""
    away = distance * random.uniform(0.8, 1.4)
    tilt, turn = math.radians(random.uniform(20, 50)), random.uniform(0, 2 * math.pi)
    if kind in ("ring", "area_ring"):
        tilt, away = 0.0, distance
    side = away * math.sin(tilt)
    place = (side * math.cos(turn), side * math.sin(turn), away * math.cos(tilt))
    table: Table = {"position": lengths(place), "look_at": lengths([*(seen * random.uniform(-0.2, 0.2, 2)), 0.0])}
    intensity = strength * away**2
    if kind == "ies":
        return table | {
            "file": "lamp.ies",
            "diameter": length(away * 0.01),
            "luminous_efficacy": f"{100 / intensity:.6g} lm/W",
            **({"up": [0.3, 0.2, 1.0]} if random.random() < 0.5 else {}),
        }
    if kind in ("rectangle", "area_ring"):
        size = away * random.uniform(0.1, 0.3, 2)
        table |= {"irradiance_error": _ASKED, "beam": {"profile": "lambertian"}}
        table["radiant_intensity"] = f"{intensity:.6g} W/sr"
        if kind == "rectangle":
            return table | {"size": lengths(size)}
        inner = 2 * seen * 0.2 + 0.1 * distance
        return table | {"inner_diameter": length(inner), "diameter": length(inner + size[0])}
    if kind == "ring":
        return table | {"beam": _beam(random)} | _ring(intensity, distance, random)
    if random.random() < 0.3:
        table |= {"radiant_flux": f"{3 * intensity:.6g} W"}
    else:
        table |= {"radiant_intensity": f"{intensity:.6g} W/sr"}
    if kind == "disc":
        return table | {"diameter": length(away * 0.02)}
    table["beam"] = _beam(random)
    return table | {"diameter": length(away * random.uniform(0.002, 0.02))}


def _ring(intensity: float, distance: float, random: np.random.Generator) -> Table:
    """A ring of LEDs about the camera, some of them unlike the others."""
    count = int(random.integers(2, 7)) * 2
    changed: list[Table] = [
        {
            "index": index,
            "radiance_factor": round(float(random.uniform(0.2, 1.5)), 3),
            "axis_tilt": f"{random.uniform(0, 8):.3f} deg",
            "axis_azimuth": f"{random.uniform(0, 360):.3f} deg",
        }
        for index in range(count)
        if random.random() < 0.3
    ]
    table: Table = {
        "count": count,
        "diameter": length(distance * random.uniform(0.2, 0.5)),
        "led_diameter": length(distance * 0.01),
        "first_angle": f"{random.uniform(0, 360):.3f} deg",
        "leds": changed,
        "radiant_intensity": f"{intensity / count:.6g} W/sr",
    }
    if random.random() < 0.3:
        table["misalignment"] = {"about_y": "2 deg", "about_z": "3 deg"}
    return table
