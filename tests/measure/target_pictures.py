"""Pictures of targets with a pattern without a tracer: shares of pixels, by points spread over each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from radwrap.frames import Pose, rotation_about_fixed_axes
from radwrap.images import GrayImage
from radwrap.scene.file.load import load_scene
from radwrap.scene.look.geometry import directions
from radwrap.scene.look.intersections import first_hit
from radwrap.scene.scene import Scene
from radwrap.scene.targets import PatternTarget

TARGETS = Path(__file__).parents[2] / "rad_scenes" / "targets"
DARK, PLATE, AROUND = 12.0, 150.0, 190.0  # gray levels


def scene_with(name: str, tilt: tuple[float, float, float], place: tuple[float, float, float] = (0, 0, 0)) -> Scene:
    """A scene of rad_scenes/targets, its target turned by degrees about x, y, z and moved [m]."""
    scene = load_scene(TARGETS / f"{name}.toml")
    (target,) = scene.targets
    pose = Pose(place, rotation_about_fixed_axes([float(np.radians(angle)) for angle in tilt]))
    return replace(scene, targets=(replace(target, pose=pose),))


def picture(scene: Scene, samples: int = 4, noise: float = 0.0, seed: int = 0) -> GrayImage:
    """What a scene's one target looks like in even light, with samples x samples points a pixel at outlines."""
    camera, (target,) = scene.camera, scene.targets
    assert isinstance(target, PatternTarget)
    shape = (camera.sensor.rows, camera.sensor.columns)
    v, u = (part.astype(float) for part in np.indices(shape))
    gray = _shown(scene, target, u.ravel(), v.ravel()).reshape(shape)
    around = maximum_filter(gray, 3) - minimum_filter(gray, 3)
    (edge,) = np.nonzero(around.ravel())
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    right, down = (part.ravel() for part in np.meshgrid(steps, steps))
    fine = _shown(
        scene,
        target,
        (u.ravel()[edge, np.newaxis] + right).ravel(),
        (v.ravel()[edge, np.newaxis] + down).ravel(),
    )
    gray.ravel()[edge] = fine.reshape(len(edge), -1).mean(axis=1)
    if noise:
        gray += noise * np.random.default_rng(seed).standard_normal(shape)
    return GrayImage(np.clip(np.rint(gray), 0, 255))


def _shown(scene: Scene, target: PatternTarget, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Gray levels at points of the image [px]."""
    eye = np.asarray(scene.camera.pose.position)
    rays = directions(scene.camera, np.column_stack([u, v]))
    distance, _ = first_hit(target, eye, rays)
    met = np.isfinite(distance)
    gray = np.full(len(u), AROUND)
    points = eye + distance[met, np.newaxis] * rays[met]
    local = (points - np.asarray(target.pose.position)) @ np.asarray(target.pose.rotation)
    gray[met] = np.where(target.partition.covered(local[:, :2]), DARK, PLATE)
    return gray
