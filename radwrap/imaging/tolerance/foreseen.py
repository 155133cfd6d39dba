"""What corrections of a kernel are expected to take, by pilot pairs at some pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.imaging.methods.depth_steps import cost_on_grid
from radwrap.imaging.methods.hybrid import (
    PAIRS,
    HybridPlan,
    Needs,
    Seen,
    are_near,
    is_looked_at_nearer,
    look_rays,
    of_pairs,
    rays_of,
    signed_numbers,
)
from radwrap.imaging.methods.pairs import paired
from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.survey import Survey, surveyed_places
from radwrap.random_streams import Rendering, generator

_PIXELS: Final = 128
# Pixels, to tell how many lie near steps of those that the survey's coarse grid names, and rays for that. Where the
# reach takes more for each pixel the grid tells enough: its points lie no farther apart.
_LOOKED_AT: Final = 1024
_LOOK_RAYS: Final = 1 << 18
_WIDEST_LOOK: Final = 1 << 10  # rays


def seen_by(view: View, found: Survey) -> tuple[Seen, int]:
    """What the survey's grid of central rays sees, and how many rays that takes."""
    sensor, numbers = view.camera.sensor, found.magnification.shape
    values, _ = trace_rays(view, None, *surveyed_places(sensor))
    gray = gray_levels(values * view.exposure_of_radiance, sensor).reshape(numbers)
    cost = cost_on_grid(view.camera, (sensor.rows, sensor.columns), found.magnification, gray)
    return Seen(float(np.abs(found.magnification).max()), cost), values.size


@dataclass(frozen=True, slots=True, eq=False)
class Foreseen:
    """What some pixels near steps in depth need.

    Attributes
    ----------
    near, asked : float
        Pixels of the image that get pilot pairs, and that are asked by a ray whether they need them; all and not only
        those looked at.
    needs : Needs
        Of those looked at.
    rays : int
        What it took to find out.
    """

    near: float
    asked: float
    needs: Needs
    rays: int

    def corrections(self, plan: HybridPlan, aim: float, number: int) -> float:
        """Rays that pilot and corrections of so many replicates are expected to take, at an aim for each."""
        looked_at = len(self.needs.due)
        if not looked_at:
            return self.asked
        often, pixels = self.near / looked_at, plan.camera.sensor.pixels
        signed = signed_numbers(replace(plan, aim=aim), self.needs, pixels / often)
        # How many differ around a pixel is not known of single ones.
        return self.asked + self.near * PAIRS * plan.pair_rays + often * number * rays_of(signed, plan.pair_rays)


def foresee(view: View, plan: HybridPlan, seed: int) -> Foreseen:
    """Look at some of the pixels that a hybrid would look at."""
    sensor, cost = view.camera.sensor, plan.seen.cost
    near = np.flatnonzero(cost > plan.least)
    random = generator(seed, Rendering.FORESEEN_PIXELS)
    asked = len(near) / cost.size * sensor.pixels
    if is_looked_at_nearer(plan) and look_rays(plan) <= _WIDEST_LOOK:
        rows, columns, looks = _some_near(view, plan, near, random)
        found_near = asked * len(rows) / max(looks, 1)
        rows, columns, looks = rows[:_PIXELS], columns[:_PIXELS], looks * look_rays(plan)
    else:
        drawn = random.choice(near, min(len(near), _PIXELS), replace=False) if len(near) else near
        columns, rows = (np.rint(places[drawn]).astype(np.intp) for places in surveyed_places(sensor))
        found_near, looks = asked, 0
    places = rays_over(view.camera, columns.astype(np.float64), rows.astype(np.float64), PAIRS, random)
    values, differences = (found.reshape(len(rows), PAIRS) for found in paired(view, plan.kernel.layers, *places))
    found = of_pairs(plan, values, differences).needs(plan, lambda each: each)
    return Foreseen(found_near, asked, found, looks + values.size * plan.pair_rays)


def _some_near(
    view: View, plan: HybridPlan, near: NDArray[np.intp], random: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp], int]:
    """Rows and columns of pixels near steps, of some drawn at points of the survey's grid, and how many were."""
    if not near.size:
        return near, near, 0
    sensor, numbers = view.camera.sensor, plan.seen.cost.shape
    looks = min(_LOOKED_AT, _LOOK_RAYS // look_rays(plan))
    points = np.divmod(random.choice(near, looks), numbers[1])
    rows, columns = (
        np.minimum(((point + random.random(looks)) * size / number).astype(np.intp), size - 1)
        for point, size, number in zip(points, (sensor.rows, sensor.columns), numbers, strict=True)
    )
    some = are_near(view, plan, rows, columns)
    return rows[some], columns[some], looks
