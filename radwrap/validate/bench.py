"""An optical bench: scene documents in SI numbers, rendered by radwrap's own public functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.rendered import Rendered
from radwrap.imaging.synthesis import render
from radwrap.imaging.tracing import traced_scene
from radwrap.scene.file.load import scene_from_document
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
Point = Sequence[float] | NDArray[np.float64]

ORIGIN: Final = (0.0, 0.0, 0.0)
# The camera of a bench: one second through 0.1 mm, 10 mm behind it; gray levels are radiant exposure times 1.
FOCAL_LENGTH: Final = 0.01
DIAMETER: Final = 1e-4


def metres(*values: float) -> list[str]:
    """Lengths as a scene file has them."""
    return [f"{float(value)!r} m" for value in values]


def degrees(*values: float) -> list[str]:
    """Angles as a scene file has them."""
    return [f"{float(value)!r} deg" for value in values]


def camera(
    position: Point = (0.0, 0.0, 1.0),
    look_at: Point = ORIGIN,
    *,
    size: tuple[int, int] = (1, 1),
    pitch: tuple[float, float] = (1e-6, 1e-6),
    sensor: Mapping[str, Any] | None = None,
    **more: Any,
) -> dict[str, Any]:
    """A camera of `size` rows and columns, `pitch` wide and high pixels [m]; `more` replaces keys of the table."""
    plain = {
        "rows": size[0],
        "columns": size[1],
        "pixel_width": metres(pitch[0])[0],
        "pixel_height": metres(pitch[1])[0],
        "gain": "1 (J/m^2)^-1",
        "gamma": 1.0,
        "dark_gray": 0,
        "saturation_gray": 65535,
        "bit_depth": 16,
        "rounding": False,
    }
    return {
        "position": metres(*position),
        "look_at": metres(*look_at),
        "focal_length": metres(FOCAL_LENGTH)[0],
        "exposure_time": "1 s",
        "aperture": {"diameter": metres(DIAMETER)[0]},
        "diffraction": "off",  # closed forms are those of rays
        "sensor": {**plain, **(sensor or {})},
        **more,
    }


def lamp(
    position: Point,
    look_at: Point = ORIGIN,
    *,
    radiant_intensity: float = 1.0,
    half_angle: float | None = 60.0,
    diameter: float = 1e-3,
    name: str = "lamp",
) -> dict[str, Any]:
    """A lamp of the same radiant intensity within a cone, or with `half_angle` None a Lambertian one."""
    cone = {"profile": "cone", "width": f"{half_angle!r} deg", "width_definition": "half_angle"}
    return {
        "type": "lamp",
        "name": name,
        "position": metres(*position),
        "look_at": metres(*look_at),
        "diameter": metres(diameter)[0],
        "radiant_intensity": f"{radiant_intensity!r} W/sr",
        "beam": {"profile": "lambertian"} if half_angle is None else cone,
    }


def sheet(size: float = 4.0, material: str = "it", **more: Any) -> dict[str, Any]:
    """A square sheet about the origin, which faces +z."""
    return {"type": "sheet", "material": material, "size": metres(size, size), **more}


def lambertian(reflectance: float) -> dict[str, Any]:
    """A diffuse material."""
    return {"type": "lambertian", "reflectance": reflectance}


def scene(
    seen_by: Mapping[str, Any],
    sources: Iterable[Mapping[str, Any]],
    materials: Mapping[str, Mapping[str, Any]],
    targets: Iterable[Mapping[str, Any]],
) -> Scene:
    """A validated scene."""
    tables = {"camera": seen_by, "sources": list(sources), "materials": materials, "targets": list(targets)}
    return scene_from_document(tables, origin="validate")


def radiances(scene: Scene, exposure: Array) -> Array:
    """Mean of L cos^4 [W m^-2 sr^-1] of each pixel from its radiant exposure, by H = tau A/f^2 L cos^4."""
    seen_by = scene.camera
    values: Array = exposure * seen_by.focal_length**2 / (seen_by.exposure_time * seen_by.aperture.area)
    return values


@dataclass(frozen=True, slots=True)
class Bench:
    """How scenes are rendered, and who is told that one more was.

    Attributes
    ----------
    options : RenderOptions
        For workers, the seed and which Radiance.
    tick : callable
        Called after each rendering.
    """

    options: RenderOptions
    tick: Callable[[], None] = lambda: None

    def render(self, scene: Scene, **changes: Any) -> Rendered:
        """As `radwrap.render`, without a folder."""
        result = render(scene, None, self.options, **changes)
        self.tick()
        return result

    def exposure(self, scene: Scene, **changes: Any) -> Array:
        """Radiant exposure of each pixel [J m^-2]; by the infinitesimal pinhole unless a change says otherwise."""
        how = changes or {"method": "pinhole"}
        return self.render(scene, **how).radiant_exposure.values

    def radiance(self, scene: Scene, eyes: Any, points: Any) -> Array:
        """Radiance from points of the world, shape (n, 3), towards an eye or as many eyes [W m^-2 sr^-1]."""
        points = np.asarray(points, dtype=np.float64)
        eyes = np.broadcast_to(np.asarray(eyes, dtype=np.float64), points.shape)
        with traced_scene(scene, self.options) as view:
            values = np.concatenate(list(view.tracer.trace([np.hstack([eyes, points - eyes])])))
        self.tick()
        return values

    def irradiance(self, scene: Scene, points: Any, reflectance: float) -> Array:
        """Irradiance at points of a Lambertian plane that faces +z, by its radiance: E = pi L/rho [W m^-2]."""
        points = np.asarray(points, dtype=np.float64)
        return self.radiance(scene, points + np.array([0.0, 0.0, 0.05]), points) * math.pi / reflectance
