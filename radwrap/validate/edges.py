"""Sections 4 and 8: an edge through the finite pinhole (Eqs. 8 and 9), and its measurement."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.images import GrayImage
from radwrap.measure.edges import measure_edge
from radwrap.scene.scene import Scene
from radwrap.validate import bench as on
from radwrap.validate.bench import Bench
from radwrap.validate.case import Case, Check, Finding, Plot
from radwrap.validate.closed_forms.aperture import blurred_edge, cos4, projection_radius, share_beyond

Array = NDArray[np.float64]

_F: Final = 10.59e-3
_OPENING: Final = 1e-4
_PITCH: Final = 13.75e-6
_DIRECTIONS: Final = 6  # of the edge, over a full turn
_SAMPLES: Final = 3  # squared: rays of a pixel and sub-viewpoint
_POINTS: Final = 16  # squared: points of a pixel for Eq. 2 of the reference
# (distance, sub-viewpoints) -> rms over |S| <= 1. At 3 f a shift of the wrong sign gives 0.13, at 1 m it hides.
_CASES: Final = {"1_m": (1.0, 37, 0.012), "1_m_fine": (1.0, 127, 0.005), "3_f": (3 * _F, 61, 0.015)}
_PLACE: Final = 5e-4  # px: what 16 x 16 points of a pixel leave of the place of a synthetic edge


def _edge_scene(depth: float, angle: float, side: int, offset: tuple[float, float]) -> Scene:
    """Black beside white on the axis, turned about it; white has the radiance 1."""
    middle = (side - 1) / 2
    camera = on.camera(
        (0.0, 0.0, depth),
        size=(side, side),
        pitch=(_PITCH, _PITCH),
        focal_length=on.metres(_F)[0],
        principal_point=[f"{middle + offset[0]!r} px", f"{middle + offset[1]!r} px"],
        aperture={"diameter": on.metres(_OPENING)[0]},
    )
    # So far away that its irradiance differs by 1e-10 over what is seen.
    lamp = on.lamp((0.0, 0.0, 1000.0), diameter=1.0, half_angle=5.0, radiant_intensity=1e6 * math.pi)
    edge: dict[str, Any] = {"type": "edge", "material": "black", "edge_material": "white", "size": on.metres(4, 4)}
    edge["rotation"] = on.degrees(0, 0, angle)
    return on.scene(camera, [lamp], {"black": on.lambertian(0.0), "white": on.lambertian(1.0)}, [edge])


def _expected(depth: float, angle: float, side: int, offset: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Eq. 9 averaged over each pixel; S and cos^4 at the pixel's centre."""
    along = np.arange(side) - (side - 1) / 2
    columns, rows = ((along - start) * _PITCH for start in offset)
    turn = -math.radians(angle)  # rows run down, y up
    radius = projection_radius(_OPENING, depth, _F) * _F / depth
    mean = blurred_edge(columns, rows, (_PITCH, _PITCH), angle=turn, radius=radius, points=_POINTS)
    x, y = np.meshgrid(columns, rows)
    return mean, (x * math.cos(turn) + y * math.sin(turn)) / radius, cos4(x, y, _F)


def _eq9(name: str) -> Check:
    depth, count, limit = _CASES[name]
    full = f"4.eq9_{name}_{count}_viewpoints"

    def run(bench: Bench) -> Iterator[Finding]:
        radius = projection_radius(_OPENING, depth, _F)
        side = 2 * math.ceil(radius * _F / depth / _PITCH) + 3
        squares: list[Array] = []
        seen: list[tuple[Array, Array]] = []
        for turn in range(_DIRECTIONS):
            at = (360 * (turn + 0.37) / _DIRECTIONS, side, (0.5 * math.cos(5 * turn), 0.5 * math.sin(7 * turn)))
            scene = _edge_scene(depth, *at)
            exposure = bench.exposure(scene, viewpoints=count, pixel_samples=_SAMPLES)
            mean, s, falloff = _expected(depth, *at)
            found = on.radiances(scene, exposure) / falloff
            counted = np.abs(s) <= 1
            squares.append((found - mean)[counted] ** 2)
            seen.append((s[counted], found[counted]))
        rms = float(np.sqrt(np.concatenate(squares).mean()))
        yield Case(full, "Eq. 9, mean over the pixel; rms", 0.0, rms, limit, "absolute")
        s, found = (np.concatenate(parts) for parts in zip(*seen, strict=True))
        line = np.linspace(-1, 1, 101)
        curves = {"radwrap": (s, found), "reference: Eq. 9 at a point": (line, share_beyond(line))}
        yield Plot(f"Edge, {name.replace('_', ' ')}, {count} sub-viewpoints", "S", "share", curves)

    return Check(full, (full,), run)


def _measured(bench: Bench) -> Iterator[Finding]:
    """A synthetic edge of 2 px blur in any direction, gamma fitted; place and radius come back."""
    places, radii = [], []
    for angle, radius, gamma in ((0.0, 3.67, 0.85), (0.31, 2.0, 1.4), (-0.9, 3.0, 0.6), (1.5, 5.0, 1.0)):
        offset = 29.3 * math.cos(angle) + 28.6 * math.sin(angle)
        light = blurred_edge(
            np.arange(60), np.arange(56), (1, 1), angle=angle, radius=radius, offset=offset, points=_POINTS
        )
        edge = measure_edge(GrayImage(20 + 160 * light**gamma))
        sign = 1 if math.cos(edge.angle - angle) > 0 else -1
        places.append(abs(sign * edge.offset - offset))
        radii.append(abs(edge.radius - radius))
    bench.tick()
    yield Case("8.edge_place", "Eq. 9 by brute force; largest of four, px", 0.0, max(places), _PLACE, "absolute")
    yield Case("8.edge_radius", "Eq. 9 by brute force; largest of four, px", 0.0, max(radii), _PLACE, "absolute")


CHECKS: Final = (*map(_eq9, _CASES), Check("8.edge", ("8.edge_place", "8.edge_radius"), _measured))
