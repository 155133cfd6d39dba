"""An optical bench: lay out a camera, sources and targets in SI numbers, and read what arrives.

It only sets up and measures; the numbers that are expected stand in the tests.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import radwrap
from radwrap.imaging.optics.aperture import Viewpoints, central_viewpoint
from radwrap.imaging.optics.view import PixelPlan, RayBlock, pixel_means, ray_blocks, traced
from radwrap.process import Programs
from radwrap.scene.camera import Camera
from radwrap.scene.look.wide_sources import divided
from radwrap.tracers.compiled.layout import compiled_scene
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.engine import EngineName
from radwrap.tracers.expressible import inexpressible
from radwrap.tracers.installation import find_radiance
from radwrap.tracers.radiance import RadianceOptions, RadianceTracer, build, prepare
from radwrap.tracers.text_frame import traced_frame
from radwrap.tracers.tracer import Tracer

ORIGIN = (0.0, 0.0, 0.0)
Point = Sequence[float]
Bend = Callable[[RayBlock, Camera, tuple[float, float]], RayBlock]


@dataclass(frozen=True)
class Bench:
    """Scenes from numbers in m, W, sr and degrees, traced by the real Radiance or by our own tracer."""

    programs: Programs
    folder: Path
    numbers: Iterator[int]
    engine: EngineName

    @staticmethod
    def metres(*values: float) -> list[str]:
        """Lengths as a scene file has them."""
        return [f"{float(value)!r} m" for value in values]

    @staticmethod
    def degrees(*values: float) -> list[str]:
        """Angles as a scene file has them."""
        return [f"{float(value)!r} deg" for value in values]

    @classmethod
    def camera(
        cls,
        position: Point = (0.0, 0.0, 1.0),
        look_at: Point = ORIGIN,
        *,
        rows: int = 1,
        columns: int = 1,
        pitch: tuple[float, float] = (1e-6, 1e-6),
        focal_length: float = 0.01,
        aperture: Mapping[str, Any] | None = None,
        **more: Any,
    ) -> dict[str, Any]:
        """A camera of 1 s exposure whose gray levels play no part."""
        sensor = {
            "rows": rows,
            "columns": columns,
            "pixel_width": cls.metres(pitch[0])[0],
            "pixel_height": cls.metres(pitch[1])[0],
            "gain": "1 (J/m^2)^-1",
            "gamma": 1.0,
            "dark_gray": 0,
            "saturation_gray": 65535,
            "bit_depth": 16,
            "rounding": False,
        }
        attitude = {} if "rotation" in more else {"look_at": cls.metres(*look_at)}
        place = {} if "translation" in more else {"position": cls.metres(*position)}
        return {
            "focal_length": cls.metres(focal_length)[0],
            "exposure_time": "1 s",
            "aperture": {"diameter": "0.1 mm"} | dict(aperture or {}),
            "diffraction": "off",  # closed forms are those of rays
            "sensor": sensor,
            **place,
            **attitude,
            **more,
        }

    @classmethod
    def lamp(
        cls,
        position: Point,
        look_at: Point = ORIGIN,
        *,
        diameter: float = 1e-3,
        half_angle: float = 60.0,
        radiant_intensity: float = 1.0,
        name: str = "lamp",
    ) -> dict[str, Any]:
        """A source of the same radiant intensity in all directions of a wide cone."""
        return {
            "type": "lamp",
            "name": name,
            "position": cls.metres(*position),
            "look_at": cls.metres(*look_at),
            "diameter": cls.metres(diameter)[0],
            "radiant_intensity": f"{radiant_intensity!r} W/sr",
            "beam": {
                "profile": "cone",
                "width": cls.degrees(half_angle)[0],
                "width_definition": "half_angle",
            },
        }

    @staticmethod
    def scene(
        camera: Mapping[str, Any],
        sources: Iterable[Mapping[str, Any]],
        materials: Mapping[str, Mapping[str, Any]],
        targets: Iterable[Mapping[str, Any]],
    ) -> radwrap.Scene:
        """A validated scene, wide sources of which have the patches that Radiance needs."""
        document = {"camera": camera, "sources": list(sources), "materials": materials, "targets": list(targets)}
        return divided(radwrap.scene_from_document(document))

    def tracer(self, scene: radwrap.Scene) -> Tracer:
        """Radiance with the scene's frozen octree, or the compiled tracer where it can show the scene."""
        if self.engine == "compiled" and not inexpressible(scene):
            return CompiledTracer(compiled_scene(scene, traced_frame(scene)))
        folder = self.folder / str(next(self.numbers))
        folder.mkdir()
        options = RadianceOptions(find_radiance())
        prepared = prepare(scene, options, self.programs, folder)
        build(prepared.scene.text, prepared.scene.files, folder, options, self.programs)
        return RadianceTracer(options, self.programs, folder, prepared.scene)

    def radiance(self, scene: radwrap.Scene, eyes: Any, points: Any) -> np.ndarray:
        """Radiance from points of the world, shape (n, 3), towards an eye or as many eyes [W m^-2 sr^-1]."""
        points = np.asarray(points, dtype=float)
        eyes = np.broadcast_to(np.asarray(eyes, dtype=float), points.shape)
        return np.concatenate(list(self.tracer(scene).trace([np.hstack([eyes, points - eyes])])))

    def irradiance(self, scene: radwrap.Scene, points: Any, reflectance: float) -> np.ndarray:
        """Irradiance at points of a Lambertian plane that faces +z, by its radiance: E = pi L/rho [W m^-2]."""
        points = np.asarray(points, dtype=float)
        return self.radiance(scene, points + np.array([0.0, 0.0, 0.05]), points) * math.pi / reflectance

    def image(
        self, scene: radwrap.Scene, viewpoints: Viewpoints | None = None, samples: int = 1, bend: Bend | None = None
    ) -> np.ndarray:
        """Mean over opening and pixels of L cos^4, shape (rows, columns) [W m^-2 sr^-1]."""
        views = viewpoints if viewpoints is not None else central_viewpoint(scene.camera.aperture)
        return self.mean(scene.camera, views, self.tracer(scene), samples, bend)

    @staticmethod
    def mean(
        camera: Camera, viewpoints: Viewpoints, tracer: Tracer, samples: int = 1, bend: Bend | None = None
    ) -> np.ndarray:
        """As `image`, through one process for all sub-viewpoints; `bend` may replace a block's rays."""
        weights: list[float] = []

        def blocks() -> Iterator[RayBlock]:
            for (u, v), weight in zip(viewpoints.positions.tolist(), viewpoints.weights, strict=True):
                for block in ray_blocks(camera, (u, v), PixelPlan(samples)):
                    weights.append(weight)
                    yield block if bend is None else bend(block, camera, (u, v))

        total = np.zeros(camera.sensor.pixels)
        for place, (block, radiance) in enumerate(traced(tracer.trace, blocks())):
            total[block.first : block.first + block.pixels] += weights[place] * pixel_means(block, radiance)
        return total.reshape(camera.sensor.rows, camera.sensor.columns)


@pytest.fixture(scope="session", params=["radiance", pytest.param("compiled", marks=pytest.mark.long)])
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """The bench; its programs end with it. Both tracers must keep the same closed forms."""
    with Programs() as programs:
        yield Bench(programs, tmp_path_factory.mktemp("bench"), count(), request.param)
