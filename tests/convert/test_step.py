"""A STEP file, which names its unit, through cascadio."""

import itertools
import json
import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from radwrap.cli.main import main

SIZE = (20.0, 12.0, 8.0)  # mm
FLOAT32 = 1e-6  # the triangles come as glTF
# Each face counter-clockwise seen from outside, by the ends of the three sides.
FACES = (
    "000 010 110 100",
    "001 101 111 011",
    "000 100 101 001",
    "010 011 111 110",
    "000 001 011 010",
    "100 110 111 101",
)
CONTEXT = """\
(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({unit}.METRE.))
(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))
(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())"""


class StepFile:
    """Entities of a STEP file, numbered as they come."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, entity: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={entity};")
        return f"#{len(self.lines)}"

    def direction(self, vector: Sequence[float]) -> str:
        return self.add(f"DIRECTION('',({','.join(f'{x / math.hypot(*vector):.6f}' for x in vector)}))")


def box(unit: str) -> str:
    """A box as a boundary of six planes (AP214)."""
    step = StepFile()
    corners = {key: tuple(a * s for a, s in zip(key, SIZE, strict=True)) for key in itertools.product((0, 1), repeat=3)}
    points = {key: step.add(f"CARTESIAN_POINT('',({x:.6f},{y:.6f},{z:.6f}))") for key, (x, y, z) in corners.items()}
    ends = {key: step.add(f"VERTEX_POINT('',{point})") for key, point in points.items()}
    edges: dict[tuple[tuple[int, ...], ...], str] = {}

    def edge(a: tuple[int, ...], b: tuple[int, ...]) -> str:
        pair = tuple(sorted((a, b)))
        if pair not in edges:
            away = [q - p for p, q in zip(corners[pair[0]], corners[pair[1]], strict=True)]
            vector = step.add(f"VECTOR('',{step.direction(away)},{math.hypot(*away):.6f})")
            line = step.add(f"LINE('',{points[pair[0]]},{vector})")
            edges[pair] = step.add(f"EDGE_CURVE('',{ends[pair[0]]},{ends[pair[1]]},{line},.T.)")
        return step.add(f"ORIENTED_EDGE('',*,*,{edges[pair]},{'.T.' if pair == (a, b) else '.F.'})")

    faces = []
    for text in FACES:
        keys = [tuple(map(int, word)) for word in text.split()]
        sides = [edge(a, b) for a, b in zip(keys, keys[1:] + keys[:1], strict=True)]
        loop = step.add(f"EDGE_LOOP('',({','.join(sides)}))")
        bound = step.add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        u, w = ([q - p for p, q in zip(corners[keys[0]], corners[keys[i]], strict=True)] for i in (1, 3))
        normal = (u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0])
        frame = step.add(f"AXIS2_PLACEMENT_3D('',{points[keys[0]]},{step.direction(normal)},{step.direction(u)})")
        faces.append(step.add(f"ADVANCED_FACE('',({bound}),{step.add(f'PLANE({chr(39)}{chr(39)},{frame})')},.T.)"))
    shell = step.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = step.add(f"MANIFOLD_SOLID_BREP('',{shell})")
    units = ",".join(step.add(entity) for entity in CONTEXT.format(unit=unit).splitlines())
    context = step.add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT(({units}))REPRESENTATION_CONTEXT('',''))"
    )
    shape = step.add(f"ADVANCED_BREP_SHAPE_REPRESENTATION('',({solid}),{context})")
    use = step.add("APPLICATION_CONTEXT('automotive design')")
    product = step.add(f"PRODUCT('block','block','',({step.add(f'PRODUCT_CONTEXT($,{use},$)')}))")
    formation = step.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    design = step.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{use},'design')")
    definition = step.add(f"PRODUCT_DEFINITION('design','',{formation},{design})")
    step.add(f"SHAPE_DEFINITION_REPRESENTATION({step.add(f'PRODUCT_DEFINITION_SHAPE($,$,{definition})')},{shape})")
    head = "FILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\nFILE_SCHEMA(('AUTOMOTIVE_DESIGN'));"
    return (
        f"ISO-10303-21;\nHEADER;\n{head}\nENDSEC;\nDATA;\n" + "\n".join(step.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
    )


@pytest.mark.parametrize(
    ("unit", "millimetres"), [pytest.param(".MILLI.,", 1.0, marks=pytest.mark.long), ("$,", 1000.0)]
)
def test_a_step_file(unit: str, millimetres: float, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("cascadio", reason="cascadio is not installed: STEP files were not read")
    (tmp_path / "block.step").write_text(box(unit))
    assert main(["convert", str(tmp_path / "block.step"), str(tmp_path / "block.rad"), "--json"]) == 0
    # The library's own talk on stdout must not reach ours.
    (report,) = json.loads(capfd.readouterr().out)["groups"].values()
    x, y, z = (side * millimetres * 1e-3 for side in SIZE)
    assert report["volume_m3"] == pytest.approx(x * y * z, rel=FLOAT32)
    assert report["area_m2"] == pytest.approx(2 * (x * y + y * z + z * x), rel=FLOAT32)
    assert report["bounds_m"][1] == pytest.approx([x, y, z], rel=FLOAT32)
