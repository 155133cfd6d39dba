"""What corrections of a kernel are expected to take, by pilot pairs at some pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from radwrap.imaging.methods.depth_steps import cost_on_grid
from radwrap.imaging.methods.hybrid import PAIRS, HybridPlan, Needs, Seen, needs, rays_of, signed_numbers
from radwrap.imaging.methods.pairs import paired
from radwrap.imaging.methods.rays import rays_over
from radwrap.imaging.optics.view import View, trace_rays
from radwrap.imaging.response.sensor import gray_levels
from radwrap.imaging.tolerance.survey import Survey, surveyed_places
from radwrap.random_streams import Rendering, generator

_PIXELS: Final = 128


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
    near : float
        Pixels of the image that get pilot pairs, all and not only those looked at.
    needs : Needs
        Of those looked at.
    rays : int
        What it took to find out.
    """

    near: float
    needs: Needs
    rays: int

    def corrections(self, plan: HybridPlan, aim: float, number: int) -> float:
        """Rays that pilot and corrections of so many replicates are expected to take, at an aim for each."""
        looked_at = len(self.needs.due)
        if not looked_at:
            return 0.0
        often, pixels = self.near / looked_at, plan.camera.sensor.pixels
        signed = signed_numbers(replace(plan, aim=aim), self.needs, pixels / often)
        return self.near * (1 + PAIRS * plan.pair_rays) + often * number * rays_of(signed, plan.pair_rays)


def foresee(view: View, plan: HybridPlan, seed: int) -> Foreseen:
    """Look at some of the pixels that a hybrid would look at."""
    sensor, cost = view.camera.sensor, plan.seen.cost
    near = np.flatnonzero(cost > plan.least)
    random = generator(seed, Rendering.FORESEEN_PIXELS)
    drawn = random.choice(near, min(len(near), _PIXELS), replace=False) if len(near) else near
    u, v = (places[drawn] for places in surveyed_places(sensor))
    rays = rays_over(view.camera, np.rint(u), np.rint(v), PAIRS, random)
    values, differences = (found.reshape(len(drawn), PAIRS) for found in paired(view, plan.kernel.layers, *rays))
    found = needs(plan, values, differences, lambda each: each)
    return Foreseen(len(near) / cost.size * sensor.pixels, found, values.size * plan.pair_rays)
