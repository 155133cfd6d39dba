"""Scenes in which every material lies on every shape in every beam, and how they are asked of two tracers."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from radwrap.frames import Pose, aim, rotation_about_fixed_axes
from radwrap.process import Programs
from radwrap.scene.camera import Camera
from radwrap.scene.materials import (
    Anisotropic,
    CoefficientTable,
    GlassBeads,
    Lambertian,
    Material,
    MeasuredBrdf,
    PerturbedNormal,
    PrintedImage,
    PrintedSheeting,
    Specular,
)
from radwrap.scene.mesh import mesh_of
from radwrap.scene.patterns.layouts import CircleGrid, Layout, SiemensStar
from radwrap.scene.patterns.partition import partition
from radwrap.scene.scene import Scene
from radwrap.scene.sources import (
    Beam,
    Emitter,
    IntensityTable,
    Luminaire,
    Patch,
    SingleSource,
    Source,
    TableBeam,
    WideSource,
)
from radwrap.scene.targets import (
    Box,
    Cylinder,
    Disc,
    DotBoard,
    EdgeTarget,
    MeshPart,
    PatternTarget,
    Polygon,
    Sheet,
    Sphere,
    Target,
)
from radwrap.scene.wide_shapes import Annulus, Rectangle, WideShape, Zone, corners, first_cells, halves
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions, RadianceTracer, prepare
from radwrap.tracers.radiance_engine import RadianceEngine
from radwrap.tracers.tracer import Tracer
from tests.physics.conftest import Bench

# Least share of the peak that is compared with itself; what is darker is compared with that share.
DARK = 1e-6
_BULK = Lambertian(0.4)
_FLARED = tuple(map(math.radians, (0.0, 0.3, 1.0, 4.0, 30.0, 180.0)))
_TILTED = tuple(map(math.radians, (0.0, 20.0, 50.0, 85.0)))
_FALL = tuple(tuple(90 / (1 + 400 * alpha) * (1 + 0.3 * math.cos(beta)) for beta in _TILTED) for alpha in _FLARED)
_SHEETING = PerturbedNormal(0.7, 0.05)
_LOG = CoefficientTable(_FLARED, _TILTED, _FALL, "log", "hold")
_ANGLES = tuple(map(math.radians, (0.0, 35.0, 60.0, 89.0)))
_TURNS = tuple(map(math.radians, (0.0, 45.0, 120.0, 180.0)))
_BRDF = MeasuredBrdf(
    "0" * 64,
    _ANGLES,
    _ANGLES,
    _TURNS,
    tuple(
        0.1 + 0.1 * math.sin(i) * math.sin(v) * (1.2 - math.cos(a)) for i in _ANGLES for v in _ANGLES for a in _TURNS
    ),
)
_PICTURE = PrintedImage(
    "1" * 64, tuple(tuple(0.05 + 0.85 * math.sin(1 + 7 * r + 3 * c) ** 2 for c in range(5)) for r in range(3))
)

MATERIALS: Mapping[str, Material] = {
    "lambertian": Lambertian(0.6),
    "sharp": Specular(0.1, 0.6, 0.02),
    "satin": Specular(0.1, 0.6, 0.1),
    "dull": Specular(0.2, 0.5, 0.3),
    "brushed": Anisotropic(0.1, 0.6, 0.05, 0.25),
    "turned": _SHEETING,
    "linear_table": CoefficientTable(_FLARED, _TILTED, _FALL, "linear", "hold"),
    "log_table": _LOG,
    "beads": GlassBeads(60.0, "hold"),
    "printed_turned": PrintedSheeting(_SHEETING, 0.3, 0.2),
    "printed_table": PrintedSheeting(_LOG, 0.3, 0.2),
    "brdf": _BRDF,
    "picture": _PICTURE,
    "bulk": _BULK,
}

_STAR = ((0.1, 0.0), (0.03, 0.03), (0.0, 0.1), (-0.03, 0.03), (-0.1, 0.0), (0.0, -0.02))
_HULL = np.random.default_rng(7).normal(size=(14, 3))


def _part(name: str, pose: Pose, material: str) -> MeshPart:
    vertices = 0.1 * _HULL / np.linalg.norm(_HULL, axis=1, keepdims=True)
    hull = ConvexHull(vertices)
    faces = hull.simplices.astype(np.intp)
    inward = (np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))) * hull.equations[:, :3]).sum(
        1
    ) < 0
    faces[inward] = faces[inward][:, ::-1]
    return MeshPart(name, pose, material, "hull.obj", "2" * 64, mesh_of(vertices, faces))


def pattern(name: str, pose: Pose, material: str, layout: Layout) -> PatternTarget:
    """Marks of a material on a plate of another."""
    return PatternTarget(name, pose, "bulk", material, layout, partition(layout.marks(), layout.size))


SHAPES: Mapping[str, Callable[[str, Pose, str], Target]] = {
    "sheet": lambda name, pose, material: Sheet(name, pose, material, 0.2, 0.15),
    "board": lambda name, pose, material: DotBoard(name, pose, "bulk", material, 3, 4, 0.04, 0.025, 0.01),
    "edge": lambda name, pose, material: EdgeTarget(name, pose, material, "bulk", 0.2, 0.15, 0.013),
    "discs": lambda name, pose, material: pattern(name, pose, material, CircleGrid(3, 3, 0.03, 0.035, 0.01, True)),
    "star": lambda name, pose, material: pattern(name, pose, material, SiemensStar(7, 0.18, 0.03, 0.01)),
    "polygon": lambda name, pose, material: Polygon(name, pose, material, _STAR),
    "disc": lambda name, pose, material: Disc(name, pose, material, 0.2),
    "sphere": lambda name, pose, material: Sphere(name, pose, material, 0.2),
    "cylinder": lambda name, pose, material: Cylinder(name, pose, material, 0.15, 0.2),
    "box": lambda name, pose, material: Box(name, pose, material, (0.15, 0.2, 0.1)),
    "mesh": _part,
}

BEAMS: Mapping[str, Beam] = {
    "gaussian": Beam("gaussian", 0.35),
    "cosine_power": Beam("cosine_power", 0.4),
    "cone": Beam("cone", 0.3),
    "lambertian": Beam("lambertian"),
    "table": TableBeam("table", 0.9, "3" * 64, 0.0, (1.0, 0.9, 0.95, 0.5, 0.2, 0.1, 0.0)),
}
_LAMP = IntensityTable(
    "4" * 64, 1.0, 0.0, tuple(tuple(0.2 + 0.7 * math.sin(1 + k % 4 + j) ** 2 for j in range(13)) for k in range(5))
)
_WIDE: Mapping[str, tuple[WideShape, int, Beam]] = {
    "rectangle": (Rectangle(0.5, 0.3), 3, Beam("lambertian")),
    "area_ring": (Annulus(0.3, 0.4), 1, Beam("cosine_power", 0.5)),
    "surround": (Zone(4.0, 0.0, math.pi), 1, Beam("lambertian")),
}
SOURCES = (*BEAMS, "ies", *_WIDE)


def camera() -> Camera:
    """Any camera: rays come from elsewhere, only the frame of the text begins at it."""
    return replace(_camera(), pose=Pose((0.1, -0.2, 0.3)))


def _camera() -> Camera:
    target = {"type": "sheet", "name": "plane", "material": "gray", "size": Bench.metres(1.0, 1.0)}
    gray = {"gray": {"type": "lambertian", "reflectance": 0.5}}
    return Bench.scene(Bench.camera(), [Bench.lamp((0.0, 0.0, 1.0))], gray, [target]).camera


def turned(random: np.random.Generator, reach: float) -> Pose:
    """A random pose within a cube."""
    x, y, z = random.uniform(-reach, reach, 3).tolist()
    return Pose((x, y, z), rotation_about_fixed_axes(random.uniform(-math.pi, math.pi, 3).tolist()))


def source(name: str, place: tuple[float, float, float]) -> Source:
    """A source of a kind in `SOURCES` that shines from a place to the origin."""
    pose = aim(place, (0.0, 0.0, 0.0))
    if name in _WIDE:
        shape, cuts, beam = _WIDE[name]
        if name == "surround":
            pose = Pose()
        kind = "surround" if name == "surround" else "area_ring" if name == "area_ring" else "rectangle"
        level = 0.3 if name == "surround" else 40.0
        return WideSource(
            name, kind, pose, shape, level, beam, 0.1, 1, patches(name, shape, cuts, pose, level=level, beam=beam)
        )
    if name == "ies":
        lamp = Luminaire(name, place, pose.z_axis, 0.02, 3000.0, Beam("lambertian"), pose.x_axis, pose.y_axis, _LAMP)
        return SingleSource("ies", lamp)
    return SingleSource("led", Emitter(name, place, pose.z_axis, 0.01, 10000.0, BEAMS[name]))


def patches(name: str, shape: WideShape, cuts: int, pose: Pose, *, level: float, beam: Beam) -> tuple[Patch, ...]:
    """A wide shape as patches, each first cell halved so many times."""
    cells = first_cells(shape)
    for _ in range(cuts):
        cells = [half for cell in cells for half in halves(shape, cell)]
    found = []
    for number, cell in enumerate(cells):
        world = corners(shape, cell) @ np.asarray(pose.rotation).T + pose.position
        from_first = world - world[0]
        across = np.cross(from_first, np.roll(from_first, -1, axis=0)).sum(axis=0)
        length = float(np.linalg.norm(across))
        middle, axis = world.mean(axis=0).tolist(), (across / length).tolist()
        points = tuple(tuple(point) for point in world.tolist())
        radius = math.sqrt(length / 2 / math.pi)
        found.append(Patch(f"{name}.patch{number:04d}", tuple(middle), tuple(axis), radius, level, beam, points, name))
    return tuple(found)


def crowd(
    seed: int,
    materials: Iterable[str] = tuple(MATERIALS),
    shapes: Iterable[str] = tuple(SHAPES),
    sources: Iterable[str] = SOURCES,
    *,
    reach: float = 1.2,
) -> Scene:
    """A scene of all that may be combined, in random poses: grain has no direction on two faces of a box."""
    random = np.random.default_rng(seed)
    shapes = tuple(shapes)
    targets = tuple(
        SHAPES[shape](f"{shape}_{material}", turned(random, reach), material)
        for material in materials
        for shape in shapes
        if (material != "picture" or shape == "sheet") and (material, shape) != ("brushed", "box")
    )
    lights = []
    for name in sources:
        out = random.normal(size=3)
        x, y, z = (2.5 * out / np.linalg.norm(out)).tolist()
        lights.append(source(name, (x, y, z)))
    used = {name: material for name, material in MATERIALS.items() if name in {*materials, "bulk"}}
    return Scene(camera(), tuple(lights), used, targets)


def rays_at(scene: Scene, count: int, seed: int) -> np.ndarray:
    """Rays to points in and about the targets, half of them from where a light stands, for lobes back to it."""
    random = np.random.default_rng(seed)
    which = np.resize(np.arange(len(scene.targets)), count)
    places = np.array([target.pose.position for target in scene.targets])[which]
    points = places + random.uniform(-0.08, 0.08, (count, 3))
    spots = np.array([source_place(one) for one in scene.sources])
    lights = spots[random.integers(len(spots), size=count)]
    back = lights - points
    back /= np.maximum(np.linalg.norm(back, axis=1, keepdims=True), 1e-9)
    away = np.where(
        random.random((count, 1)) < 0.5, back + random.normal(0, 0.03, (count, 3)), random.normal(size=(count, 3))
    )
    eyes = points + 0.4 * away / np.linalg.norm(away, axis=1, keepdims=True)
    return np.hstack([eyes, (points - eyes) * random.uniform(0.5, 20, (count, 1))])


def source_place(one: Source) -> tuple[float, float, float]:
    """Where a source is."""
    return one.emitter.position if isinstance(one, SingleSource) else one.pose.position


@dataclass(frozen=True)
class Both:
    """One scene behind both tracers."""

    scene: Scene
    radiance: RadianceEngine
    compiled: CompiledTracer

    @classmethod
    def of(cls, scene: Scene, programs: Programs, folder: Path) -> Both:
        """Lay a scene out for both."""
        folder.mkdir(exist_ok=True)
        options = RadianceOptions(find_radiance())
        prepared = prepare(scene, options, programs, folder)
        engine = RadianceEngine(prepared, options, programs, folder, "equal")
        return cls(scene, engine, CompiledTracer(compiled_scene(scene, prepared.scene.frame)))

    def tracers(self, lit: Collection[str] | None = None) -> tuple[RadianceTracer, CompiledTracer]:
        """Both, in the light of all or some sources."""
        name = "all" if lit is None else "-".join(lit)
        arrays = self.compiled.scene
        other = self.compiled if lit is None else CompiledTracer(arrays.in_light(lit))
        return self.radiance.tracer(self.scene, lit, name=name), other


def whole(tracer: Tracer, rays: np.ndarray) -> np.ndarray:
    """Radiance along rays."""
    return np.concatenate(list(tracer.trace(np.array_split(rays, -(-len(rays) // 8192)))))


def relative(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Difference over what is expected, or over the darkest that counts."""
    least = DARK * expected.max(initial=0.0)
    return np.abs(found - expected) / np.maximum(np.maximum(expected, least), 1e-300)


_LENGTHS = {
    "width",
    "height",
    "pitch",
    "dot_diameter",
    "margin",
    "edge_position",
    "diameter",
    "length",
    "inner_diameter",
}


def scaled(scene: Scene, factor: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scene:
    """The scene so many times as large, and elsewhere; of the same radiances."""

    def place(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (factor * value + start for value, start in zip(point, shift, strict=True))
        return x, y, z

    def pose(old: Pose) -> Pose:
        return Pose(place(old.position), old.rotation)

    def emitter(old: Emitter) -> Emitter:
        new = replace(old, position=place(old.position), radius=old.radius * factor)
        return replace(new, corners=tuple(map(place, new.corners))) if isinstance(new, Patch) else new

    def target(old: Target) -> Target:
        changes: dict[str, object] = {"pose": pose(old.pose)}
        for field in fields(old):
            value = getattr(old, field.name)
            if field.name in _LENGTHS:
                changes[field.name] = value * factor
            elif field.name == "size":
                changes["size"] = tuple(factor * side for side in value)
            elif field.name == "vertices":
                changes["vertices"] = tuple((factor * x, factor * y) for x, y in value)
            elif isinstance(old, PatternTarget) and field.name == "layout":
                lengths = {one.name: getattr(value, one.name) * factor for one in fields(value) if one.name in _LENGTHS}
                larger = replace(value, **lengths)
                changes |= {"layout": larger, "partition": partition(larger.marks(), larger.size)}
            elif field.name == "mesh":
                changes["mesh"] = mesh_of(value.vertices * factor, value.faces)
        return replace(old, **changes)

    sources = tuple(
        replace(one, emitter=emitter(one.emitter))
        if isinstance(one, SingleSource)
        else replace(one, pose=pose(one.pose), patches=tuple(map(emitter, one.patches)))
        for one in scene.sources
    )
    eye = replace(scene.camera, pose=pose(scene.camera.pose))
    return replace(scene, camera=eye, sources=sources, targets=tuple(map(target, scene.targets)))


def rays_scaled(rays: np.ndarray, factor: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Rays that go where `scaled` puts what they met."""
    return np.hstack([rays[:, :3] * factor + shift, rays[:, 3:]])
