"""What a page is told of a basis: its sources where they stand, its camera, its error, and what is left out."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.forecast.effects import Effect, warnings_of_left_out
from radwrap.imaging.output.run_manifest import RunManifest
from radwrap.imaging.page.thresholds import Thresholds
from radwrap.imaging.page.turn import rings_of
from radwrap.imaging.relight.relit import Basis, Relit
from radwrap.manifest import plain
from radwrap.scene.camera import Sensor
from radwrap.scene.scene import Scene


def described(scene: Scene, basis: Basis, run: RunManifest) -> dict[str, Any]:
    """The basis, as JSON."""
    sensor = basis.sensor
    told = {line for effect in run.left_out.values() for line in warnings_of_left_out(effect)}
    return {
        "title": title_of(scene),
        "rows": sensor.rows,
        "columns": sensor.columns,
        "sources": sources_of(scene, basis.sources),
        "dark_sources": list(basis.dark),
        "exposure_time": basis.camera.exposure_time,
        "exposure_of_radiance": basis.exposure_of_radiance,
        "sensor": sensor_of(sensor),
        "tolerance": basis.tolerance,
        "seed": run.seed,
        "rays": run.rays,
        "left_out": told_left_out(run.left_out.values()),
        "warnings": [line for line in run.warnings if line not in told],  # each effect is told once
    }


def told_left_out(effects: Iterable[Effect]) -> list[dict[str, Any]]:
    """What is left out of an image and of its error."""
    keys = ("name", "left_out", "rms_gray", "rms_gray_upper95", "needed")
    return [{key: getattr(effect, key) for key in keys} for effect in effects]


def title_of(scene: Scene) -> str:
    """The scene's title, or the name of its file."""
    title = json.loads(scene.document).get("title")
    return title if isinstance(title, str) and title else scene.origin


def sources_of(scene: Scene, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Sources by name, those of a ring with their place on it: x to the right and y down as the camera looks."""
    places: dict[str, list[NDArray[np.float64]]] = {}
    for emitter in scene.emitters:
        places.setdefault(emitter.source, []).append(np.asarray(emitter.position, dtype=np.float64))
    rings = rings_of(names)
    maps: dict[str, tuple[float, float]] = {}
    axes = np.asarray(scene.camera.pose.rotation, dtype=np.float64)
    for members in rings.values():
        known = [name for name in members if name in places]
        if not known:
            continue
        points = np.stack([np.mean(places[name], axis=0) for name in known])
        seen = (points - points.mean(axis=0)) @ axes[:, :2]
        reach = float(np.abs(seen).max()) or 1.0
        maps |= {name: (float(x / reach), float(y / reach)) for name, (x, y) in zip(known, seen, strict=True)}
    ring_of = {name: ring for ring, members in rings.items() for name in members}
    return [{"name": name, "ring": ring_of.get(name), "place": maps.get(name)} for name in names]


def sensor_of(sensor: Sensor) -> dict[str, Any]:
    """Numbers of Eq. 5, and of a linear camera those that they follow from."""
    told: dict[str, Any] = {
        "gain": sensor.gain,
        "gamma": sensor.gamma,
        "dark_gray": sensor.dark_gray,
        "saturation_gray": sensor.saturation_gray,
        "bit_depth": sensor.bit_depth,
        "rounding": sensor.rounding,
    }
    if (linear := sensor.linear) is not None:
        told["linear"] = {
            "system_gain": linear.system_gain,
            "offset": linear.offset,
            "full_well": linear.full_well,
            "dark_signal": linear.dark_signal,
            "electrons_of_exposure": linear.electrons_of_exposure(sensor.pixel_area),
        }
    return told


def told_of(image: Relit, basis: Basis, sigma: NDArray[np.float64]) -> dict[str, Any]:
    """What a page says of one image."""
    gray = image.gray.values
    return {
        "error": plain(image.certificate, named=False),
        "keeps": image.keeps(basis),
        "saturated_fraction": image.saturated_fraction,
        "gray": {"min": float(gray.min()), "max": float(gray.max()), "mean": float(gray.mean())},
        "sigma_rms": float(np.sqrt(np.mean(sigma**2))),
        "exposure_of_radiance": basis.exposure_of_radiance,
        "sensor": sensor_of(basis.sensor),
    }


def told_thresholds(found: Thresholds) -> dict[str, Any]:
    """Thresholds but for their list; infinity, which JSON lacks, is None."""
    return {
        "first": found.first,
        "count": len(found.values),
        "saturated": found.saturated if np.isfinite(found.saturated) else None,
        "lit": found.lit if np.isfinite(found.lit) else None,
    }
