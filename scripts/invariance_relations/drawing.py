"""Random scenes of all kinds of parts, written as a user writes them.

Camera, opening, dot board and what stands before it are drawn as for
`certificates.py`; what is in front, lights, materials, lens, sensor and
calibration are drawn here.
"""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from certificates import COLUMNS, ROWS, draw, exposed
from invariance_relations.documents import WIDE, Table, Written, length, lengths, metres
from invariance_relations.lights import draw_sources
from radwrap.images import png_bytes

# What may stand before the main target; sheets and boxes often, as relations of their own ask for them.
EXTRAS: Final = ("sheet", "box", "polygon", "disc", "sphere", "cylinder", "part", "rad")
_MAINS: Final = ("board", "board", "edge", "print", "sheet")
# Wide lights ask hundreds of patches of glossy surfaces, and are refused over sheeting and beside mirrors.
_DIFFUSE: Final = ["white", "gray", "glossy"]


def draw_scene(number: int) -> Written | None:
    """A scene by its number, exposed so that there is something to see; None where it came out dark or even.

    Raises
    ------
    InputError
        If what was drawn is refused: too near a wide source, a part around the camera.
    """
    random = np.random.default_rng([2027, number])
    document = draw(random)
    written = Written(document, {})
    camera = document["camera"]
    distance = metres(camera["position"][2])
    seen = COLUMNS * metres(camera["sensor"]["pixel_width"]) * distance / metres(camera["focal_length"])
    document["materials"] |= _materials(random, written.files)
    document["sources"] = draw_sources(random, distance, seen, written.files)
    wide = written.has_source(*WIDE)
    kind = str(random.choice(_MAINS))
    if kind != "board":
        document["targets"][0] = _main(kind, document["targets"][0], seen, random, wide=wide)
    elif wide:
        document["targets"][0]["dot_material"] = "white"
    _add_extras(written, distance, seen, random, wide=wide)
    used = {value for target in written.targets for key, value in target.items() if key.endswith("material")}
    document["materials"] = {name: table for name, table in written.materials.items() if name in used}
    _equip(written, distance, random)
    with tempfile.TemporaryDirectory() as folder:
        written.save(Path(folder))
        scene = exposed(document, float(random.uniform(60, 260)), Path(folder))
    if scene is None:
        return None
    camera["exposure_time"] = f"{scene.camera.exposure_time!r} s"
    return written


def _materials(random: np.random.Generator, files: dict[str, bytes]) -> dict[str, Table]:
    """Materials of all kinds; those that nothing names are left out later."""
    picture = random.integers(0, 256, (int(random.integers(3, 9)), int(random.integers(3, 9)))).astype(np.uint8)
    files["label.png"] = png_bytes(picture)
    sheet = [(o, e, 400 / (1 + 4 * o) * math.cos(math.radians(e))) for o in (0, 1, 5, 45) for e in (0, 30, 60, 85)]
    files["sheet.csv"] = _csv("observation_deg,entrance_deg,coefficient", sheet)
    angles, azimuths = (0, 40, 85), (0, 90, 180)
    lobe = [
        (i, v, a, 0.1 + 0.08 * math.sin(math.radians(i)) * math.sin(math.radians(v)) * (1 - math.cos(math.radians(a))))
        for i in angles
        for v in angles
        for a in azimuths
    ]
    files["brdf.csv"] = _csv("incidence_deg,viewing_deg,azimuth_deg,brdf_per_sr", lobe)
    return {
        "satin": {"type": "specular", "diffuse_reflectance": 0.2, "specular_reflectance": 0.5, "roughness": 0.2},
        "brushed": {
            "type": "specular",
            "diffuse_reflectance": 0.2,
            "specular_reflectance": 0.5,
            "roughness": [0.12, 0.3],
        },
        "glossy": {"type": "measured_brdf", "file": "brdf.csv"},
        "beads": {"type": "retroreflective", "model": "coefficient", "file": "sheet.csv", "outside": "hold"},
        "printed": {
            "type": "retroreflective",
            "model": "perturbed_normal",
            "reflectance": 0.6,
            "roughness": 0.2,
            "print_coverage": 0.4,
            "print_reflectance": 0.3,
        },
        "label": {
            "type": "print",
            "file": "label.png",
            "encoding": str(random.choice(["linear", "srgb"])),
            "black_reflectance": 0.04,
            "white_reflectance": 0.85,
        },
        "mirror": {"type": "mirror", "reflectance": 0.8},
        "pane": {"type": "glass", "transmittance": 0.85},
    }


def _csv(header: str, rows: list[tuple[float, ...]]) -> bytes:
    return "\n".join([header, *(",".join(f"{value:g}" for value in row) for row in rows), ""]).encode()


def _main(kind: str, board: Table, seen: float, random: np.random.Generator, *, wide: bool) -> Table:
    """What fills the view in place of the board, turned as that was."""
    size = lengths(seen * random.uniform(0.7, 1.6, 2))
    main = {"name": "board", "rotation": board["rotation"], "size": size}
    dull = str(random.choice(_DIFFUSE if wide else [*_DIFFUSE, "satin", "brushed", "beads", "printed", "sheeting"]))
    if kind == "edge":
        place = length(random.uniform(-0.2, 0.2) * metres(size[0]))
        return main | {"type": "edge", "material": "dark", "edge_material": dull, "edge_position": place}
    return main | {"type": "sheet", "material": "label" if kind == "print" else dull}


def _add_extras(written: Written, distance: float, seen: float, random: np.random.Generator, *, wide: bool) -> None:
    """One to three further targets before the main one."""
    count = int(random.integers(1, 4))
    for index in range(count):
        kind = str(random.choice(EXTRAS, p=(0.25, 0.25, 0.08, 0.1, 0.08, 0.08, 0.1, 0.06)))
        if kind == "rad" and wide:
            kind = "box"
        nearness = random.uniform(0.05, 0.35)
        width = seen * (1 - nearness) * random.uniform(0.1, 0.4)
        place = [*(random.uniform(-0.4, 0.4, 2) * seen * (1 - nearness)), distance * nearness]
        table: Table = {"type": kind, "name": f"extra{index}", "position": lengths(place)}
        table["rotation"] = [f"{value:.3f} deg" for value in random.uniform(-60, 60, 3)]
        if random.random() < 0.3:
            table["rotation_order"] = str(random.choice(["xzy", "yxz", "yzx", "zxy", "zyx"]))
        written.targets.append(table | _shape(kind, width, random, written.files, wide=wide))


def _shape(kind: str, width: float, random: np.random.Generator, files: dict[str, bytes], *, wide: bool) -> Table:
    """Form and material of a further target."""
    dull = ["white", "gray", "dark", *([] if wide else ["satin"])]
    flat = [*dull, "glossy", "pane", *([] if wide else ["brushed", "beads", "printed", "sheeting", "mirror"])]
    sizes = width * random.uniform(0.3, 1, 3)
    if kind == "sheet":
        name = str(random.choice([*flat, "label"]))
        return {"size": lengths(sizes[:2]), "material": name}
    if kind in ("polygon", "disc"):
        if kind == "disc":
            return {"diameter": length(width), "material": str(random.choice(flat))}
        turns = np.sort(random.uniform(0, 2 * math.pi, int(random.integers(3, 7))))
        corners = [lengths((width / 2 * math.cos(t), width / 2 * math.sin(t))) for t in turns]
        return {"vertices": corners, "material": str(random.choice(flat))}
    name = str(random.choice(dull))
    if kind == "sphere":
        return {"diameter": length(width), "material": name}
    if kind == "cylinder":
        return {"diameter": length(sizes[0]), "length": length(sizes[1]), "material": name}
    if kind == "box":
        return {"size": lengths(sizes), "material": name}
    half = sizes / 2 * 1e3  # meshes and included files in mm
    vertices, faces = wedge(*half)
    if kind == "part":
        files["wedge.obj"] = obj_text(vertices, faces)
        return {"part": "wedge.obj", "length_unit": "1 mm", "material": name}
    files["wedge.rad"] = rad_text(vertices, faces)
    return {"rad": "wedge.rad", "length_unit": "1 mm"}


def wedge(a: float, b: float, c: float) -> tuple[list[list[float]], list[list[int]]]:
    """Vertices and outward triangles (from 0) of a body with no symmetry."""
    vertices = [[-a, -b, -c], [a, -0.6 * b, -c], [-0.3 * a, b, -c], [0.4 * a, 0.1 * b, c]]
    return vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]


def obj_text(vertices: list[list[float]], faces: list[list[int]]) -> bytes:
    """A mesh as OBJ."""
    lines = [f"v {' '.join(repr(float(x)) for x in vertex)}" for vertex in vertices]
    lines += [f"f {' '.join(str(index + 1) for index in face)}" for face in faces]
    return "\n".join([*lines, ""]).encode()


def rad_text(vertices: list[list[float]], faces: list[list[int]]) -> bytes:
    """The same as polygons of a Radiance file, in a gray plastic."""
    lines = ["void plastic paint 0 0 5 .5 .5 .5 0 0"]
    for number, face in enumerate(faces):
        numbers = " ".join(repr(float(x)) for index in face for x in vertices[index])
        lines.append(f"paint polygon face{number} 0 0 {3 * len(face)} {numbers}")
    return "\n".join([*lines, ""]).encode()


def _equip(written: Written, distance: float, random: np.random.Generator) -> None:
    """Lens, bent image, principal point, sensitive part of a pixel, and the kind of sensor."""
    camera = written.camera
    sensor = camera["sensor"]
    choices: tuple[tuple[float, Callable[[], None]], ...] = (
        (0.35, lambda: _give_lens(camera, distance, random)),
        (0.3, lambda: camera.update(principal_point=_principal_point(random))),
        (0.4, lambda: _bend(written, random)),
        (0.3, lambda: _blind(sensor, random)),
        (0.35, lambda: _make_linear(camera, random)),
    )
    for chance, give in choices:
        if random.random() < chance:
            give()


def _principal_point(random: np.random.Generator) -> list[str]:
    return [
        f"{(COLUMNS - 1) / 2 + random.uniform(-3, 3):.4f} px",
        f"{(ROWS - 1) / 2 + random.uniform(-3, 3):.4f} px",
    ]


def _give_lens(camera: Table, distance: float, random: np.random.Generator) -> None:
    """A lens in the opening, in focus or not."""
    lens: Table = {"focus_distance": length(distance * random.uniform(0.7, 1.3)), "transmission": 0.9}
    falloff = random.integers(0, 3)
    if falloff == 1:
        lens["falloff"] = "none"
    if falloff == 2:
        lens["relative_illumination"] = [["0 mm", 1.0], ["0.3 mm", 0.9], ["6 mm", 0.5]]
    if random.random() < 0.5:
        opening = camera["aperture"]
        diameter = metres(opening.pop("diameter"))
        lens["f_number"] = metres(camera["focal_length"]) / diameter
    camera["lens"] = lens


def _bend(written: Written, random: np.random.Generator) -> None:
    """Distortion, by a formula in the scene or by a calibration file beside it."""
    camera, sensor = written.camera, written.camera["sensor"]
    if "falloff" in camera.get("lens", {}) or "relative_illumination" in camera.get("lens", {}):
        return
    f = metres(camera["focal_length"])
    width, height = metres(sensor["pixel_width"]), metres(sensor["pixel_height"])
    square = (math.hypot(COLUMNS * width, ROWS * height) / 2 / f) ** 2
    k1, k2 = float(random.uniform(-0.08, 0.08)) / square, float(random.uniform(-0.02, 0.02)) / square**2
    p1, p2 = (float(value) / math.sqrt(square) for value in random.uniform(-0.01, 0.01, 2))
    form = random.integers(0, 3)
    if form == 0:
        camera["distortion"] = {"model": "opencv", "k1": k1, "k2": k2, "p1": p1, "p2": p2}
    elif form == 1:
        camera["distortion"] = {"model": "tsai", "kappa1": f"{k1 / f**2!r} 1/m^2"}
    elif "lens" not in camera:
        camera.pop("principal_point", None)
        camera.pop("focal_length")
        sensor["pixel_width"] = sensor["pixel_height"]
        centre = [(COLUMNS - 1) / 2 + random.uniform(-3, 3), (ROWS - 1) / 2 + random.uniform(-3, 3)]
        fx = f / height
        written.files["camera.json"] = calibration_text((fx, fx * 1.01), centre, (k1, k2, p1, p2), (COLUMNS, ROWS))
        camera["calibration"] = "camera.json"


def calibration_text(focal: Any, centre: Any, bend: Any, size: tuple[int, int]) -> bytes:
    """A calibration as OpenCV writes JSON."""
    matrix = [focal[0], 0.0, centre[0], 0.0, focal[1], centre[1], 0.0, 0.0, 1.0]
    told = {
        "image_width": size[0],
        "image_height": size[1],
        "camera_matrix": [float(value) for value in matrix],
        "distortion_coefficients": [float(value) for value in bend],
    }
    return json.dumps(told).encode()


def _blind(sensor: Table, random: np.random.Generator) -> None:
    """Parts of each pixel that see less."""
    if random.random() < 0.5:
        sensor.update(fill_width=0.7, fill_height=0.9)
    else:
        sensor.update(sensitivity_across=[0.2, 1.0, 0.7], sensitivity_down=[1.0, 0.5])


def _make_linear(camera: Table, random: np.random.Generator) -> None:
    """A camera of EMVA 1288 in place of the power law."""
    sensor = camera["sensor"]
    for key in ("gain", "dark_gray", "saturation_gray"):
        sensor.pop(key)
    sensor |= {
        "model": "linear",
        "wavelength": "650 nm",
        "quantum_efficiency": 0.56,
        "system_gain": "0.02 DN/e",
        "offset": 8,
        "full_well": "12 ke",
        "read_noise": "9 e",
        "gamma": float(random.choice([1.0, 0.8])),
    }
    if random.random() < 0.3:
        sensor["dark_current"] = "50 e/s"
