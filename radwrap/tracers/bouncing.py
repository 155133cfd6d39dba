"""Light that goes from surface to surface, by random walks between deterministic calls of a tracer.

A ray's radiance is what the tracer tells, light that comes straight from the
sources, and what a walk finds that goes on from the surface: at each step the
next direction is drawn by the material's own distribution, and the tracer is
asked again. Walks end by chance, so that no order of reflection is left out:
the mean is right (Kajiya 1986, key kajiya1986). Radiance's own ambient
calculation would draw the same numbers in each process, and spreads light
that a shiny surface reflects evenly over all directions.

What is drawn for a ray depends on that ray alone: the same rays give the same
radiance, in whatever order, blocks and processes they are asked for.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError, TracerError
from radwrap.scene.materials import CoefficientTable, GlassBeads, Lambertian, PerturbedNormal, Specular
from radwrap.scene.scene import Scene
from radwrap.scene.targets import surfaces
from radwrap.tracers.radiance import RadianceTracer

Array = NDArray[np.float64]
Keys = NDArray[np.uint64]
Reflecting = Lambertian | Specular

# Steps of a walk that do not end it by chance, and the largest chance to go on after them.
SURE_STEPS: Final = 3
MOST_LIKELY: Final = 0.95
# With that chance one walk in 1e22 is longer.
LONGEST_WALK: Final = 1000
# A hit is known to a float32 of its distance; a walk goes on from so far above the surface, in its distance.
ABOVE: Final = 1e-6
# Behind a surface that is seen from its back, from where its front is asked for its number, in the distance.
_BEHIND: Final = 1e-6
_BLOCKS_TOGETHER: Final = 16
ENDLESS: Final = "light never stops going between the surfaces"
DRAWS: Final = 4  # numbers that each step of a walk takes at most

# Of SplitMix64, whose hash makes keys and draws.
GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
FIRST: Final = np.uint64(0xBF58476D1CE4E5B9)
SECOND: Final = np.uint64(0x94D049BB133111EB)


@dataclass(frozen=True, slots=True)
class BouncingTracer:
    """A tracer that adds what surfaces reflect to each other; satisfies `Tracer`.

    Attributes
    ----------
    lit : RadianceTracer
        The scene.
    numbered : RadianceTracer
        The same geometry, in which each part glows with its number, 1 for the first.
    materials : tuple of Lambertian, Specular or None
        Of the parts; None of what reflects nothing, such as a lamp.
    orders : int or None
        How often light is reflected at most before it reaches what a ray sees; None for no limit.
    sure_steps : int
        Steps of a walk without limit that do not end it by chance: up to these it is that of a walk with a limit.
    """

    lit: RadianceTracer
    numbered: RadianceTracer
    materials: tuple[Reflecting | None, ...]
    orders: int | None = None
    sure_steps: int = SURE_STEPS

    def trace(self, rays: Iterable[Array]) -> Generator[Array]:
        """Radiance along rays, random with the right mean; see `Tracer.trace`."""
        blocks = iter(rays)
        while together := list(islice(blocks, _BLOCKS_TOGETHER)):
            seen = np.concatenate(together)
            radiance = _whole(self.lit.trace(_parts(seen))) + self._reflected(seen)
            yield from np.split(radiance, np.cumsum([len(block) for block in together])[:-1])

    def trace_with_distances(self, rays: Iterable[Array]) -> Generator[tuple[Array, Array]]:
        """Radiance and distance along rays; see `Tracer`."""
        for block in rays:
            yield _whole(self.trace([block])), _whole(self.lit.distances([block]))

    def distances(self, rays: Iterable[Array]) -> Generator[Array]:
        """Distance to the first surface alone [m]; see `Tracer`."""
        return self.lit.distances(rays)

    def _reflected(self, rays: Array) -> Array:
        """What walks find that begin where rays end."""
        found = np.zeros(len(rays))
        number = np.arange(len(rays))  # of the ray whose walk it is
        keys, share = keys_of(rays), np.ones(len(rays))
        here = self._surfaces(rays)
        for step in range(1, self.sure_steps + LONGEST_WALK if self.orders is None else self.orders + 1):
            draws = _draws(keys, step)
            going, weight = self._scattered(here, rays, draws)
            chance = np.ones(len(rays))
            if self.orders is None and step > self.sure_steps:
                chance = np.minimum(weight, MOST_LIKELY)
            goes = (weight > 0) & (draws[:, 3] < chance)
            share = share[goes] * weight[goes] / chance[goes]
            rays, number, keys = going[goes], number[goes], keys[goes]
            if not len(rays):
                return found
            here = self._surfaces(rays)
            # A lamp shines straight on what the walk came from, and is counted there.
            met = here.material > 0
            rays, number, keys, share, here = rays[met], number[met], keys[met], share[met], here.where(met)
            if not len(rays):
                return found
            found[number] += share * _whole(self.lit.trace(_parts(rays)))
        if self.orders is None:
            raise TracerError(ENDLESS, where="bounces")
        return found

    def _surfaces(self, rays: Array) -> _Surfaces:
        part, distance, normal = (np.concatenate(parts) for parts in zip(*self._asked(rays), strict=True))
        # A part glows to its front alone: seen from its back it is asked from behind, which is its front.
        back = (part == 0) & np.isfinite(distance)
        if back.any():
            length = distance[back] * (1 + _BEHIND)
            turned = np.hstack([_along(rays[back], length), -rays[back, 3:]])
            part[back] = _whole(self.numbered.trace(_parts(turned)))
        number = np.rint(part).astype(np.intp)
        reflecting = np.array([0] + [k if one else 0 for k, one in enumerate(self.materials, 1)], dtype=np.intp)
        material = np.where(np.isfinite(distance), reflecting[number], 0)
        facing = np.where((normal * rays[:, 3:]).sum(axis=1) > 0, -1.0, 1.0)[:, np.newaxis] * normal
        place = _along(rays, np.where(np.isfinite(distance), distance, 0.0))
        place += np.where(np.isfinite(distance), distance * ABOVE, 0.0)[:, np.newaxis] * facing
        return _Surfaces(material, place, facing)

    def _asked(self, rays: Array) -> Iterator[tuple[Array, Array, Array]]:
        with closing(self.numbered.surfaces(_parts(rays))) as answers:
            yield from answers

    def _scattered(self, here: _Surfaces, rays: Array, draws: Array) -> tuple[Array, Array]:
        """Rays that go on from surfaces, and what share of the radiance they bring counts; 0 where none goes on."""
        going, weight = np.zeros_like(rays), np.zeros(len(rays))
        going[:, :3] = here.place
        view = -rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
        for number in np.unique(here.material[here.material > 0]).tolist():
            chosen = np.flatnonzero(here.material == number)
            normal, seen, drawn = here.normal[chosen], view[chosen], draws[chosen]
            match self.materials[number - 1]:
                case Lambertian(reflectance):
                    going[chosen, 3:], weight[chosen] = _diffuse(normal, drawn), reflectance
                case Specular() as shiny:
                    going[chosen, 3:], weight[chosen] = _shiny(shiny, normal, seen, drawn)
        return going, weight


@dataclass(frozen=True, slots=True, eq=False)
class _Surfaces:
    """Where walks stand: number of the material (0: nothing that reflects), point above the surface, facing normal."""

    material: NDArray[np.intp]
    place: Array
    normal: Array

    def where(self, chosen: NDArray[np.bool_]) -> _Surfaces:
        return _Surfaces(self.material[chosen], self.place[chosen], self.normal[chosen])


def reflecting_parts(scene: Scene, parts: tuple[str, ...]) -> tuple[Reflecting | None, ...]:
    """Material of each part that reflects light from all sides; None of the sources, which do not.

    Raises
    ------
    InputError
        If a part is sheeting or an included file, or light has colours.
    """
    if scene.spectral is not None:
        raise InputError(
            "the scene has spectra, and light that goes from surface to surface changes its colour each time",
            where="bounces",
            remedy="render without bounces, or leave out the spectra",
        )
    if scene.included:
        raise InputError(
            "nothing is known of how the surfaces of an included Radiance file reflect light from all sides",
            where=f"{scene.origin}: targets[{scene.targets.index(scene.included[0])}].rad",
            remedy="render without bounces, or describe it by targets and parts",
        )
    found: dict[str, Reflecting] = {}
    for target in scene.targets:
        for surface in surfaces(target):
            material = scene.materials[surface.material]
            if not isinstance(material, Lambertian | Specular):
                raise InputError(
                    "retroreflective data end a few degrees from the light: nothing is known of how it reflects light "
                    "from all sides"
                    if isinstance(material, PerturbedNormal | CoefficientTable | GlassBeads)
                    else "bounces are known of lambertian and specular materials only",
                    where=f"{scene.origin}: materials.{surface.material}",
                    remedy="render without bounces",
                )
            found[f"{target.name}.{surface.part}"] = material
    return tuple(found.get(part) for part in parts)


def _parts(rays: Array) -> list[Array]:
    """Blocks that a tracer likes."""
    return np.array_split(rays, -(-len(rays) // (1 << 13)))


def _whole(answers: Generator[Array]) -> Array:
    with closing(answers):
        return np.concatenate(list(answers))


def _along(rays: Array, length: Array) -> Array:
    direction = rays[:, 3:] / np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    points: Array = rays[:, :3] + length[:, np.newaxis] * direction
    return points


def _mixed(values: Keys) -> Keys:
    """SplitMix64's finaliser (Steele, Lea and Flood 2014): each bit depends on all bits."""
    values = (values ^ (values >> np.uint64(30))) * FIRST
    values = (values ^ (values >> np.uint64(27))) * SECOND
    return values ^ (values >> np.uint64(31))


def keys_of(rays: Array) -> Keys:
    """A number of each ray, of all its digits."""
    words = (np.ascontiguousarray(rays) + 0.0).view(np.uint64)  # + 0.0: one zero
    keys = np.zeros(len(rays), dtype=np.uint64)
    for column in words.T:
        keys = _mixed((keys ^ column) + GOLDEN)
    return keys


def _draws(keys: Keys, step: int) -> Array:
    """Numbers of a step, even in 0 to 1, shape (n, DRAWS)."""
    order = np.arange(step * DRAWS, (step + 1) * DRAWS, dtype=np.uint64)
    numbers = _mixed(keys[:, np.newaxis] + GOLDEN * order) >> np.uint64(11)
    return numbers.astype(np.float64) * 2.0**-53


def _from_normal(normal: Array, cosine: Array, turn: Array) -> Array:
    """Unit vectors at an angle of that cosine to the normals, turned about them by shares of a full turn."""
    # Frisvad's frame by Duff et al. 2017: no branch but the sign.
    x, y, z = normal.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    across = np.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], axis=1)
    other = np.stack([x * y * a, sign + y * y * a, -y], axis=1)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    u, v = sine * np.cos(2 * np.pi * turn), sine * np.sin(2 * np.pi * turn)
    turned: Array = u[:, np.newaxis] * across + v[:, np.newaxis] * other + cosine[:, np.newaxis] * normal
    return turned


def _diffuse(normal: Array, draws: Array) -> Array:
    """Directions by the cosine law."""
    return _from_normal(normal, np.sqrt(1 - draws[:, 0]), draws[:, 1])


def _shiny(material: Specular, normal: Array, view: Array, draws: Array) -> tuple[Array, Array]:
    """Directions of the diffuse part or of Ward's lobe, each as often as it reflects, and their weights.

    Half vectors are drawn by exp(-tan^2/a^2); the lobe's weight is then cos(light)/(v.h cos(h)).
    """
    whole = material.diffuse_reflectance + material.specular_reflectance
    diffuse = draws[:, 2] * whole < material.diffuse_reflectance
    # 1 - draw lies above 0, where the logarithm ends.
    cosine = 1 / np.sqrt(1 - material.roughness**2 * np.log(1 - draws[:, 0]))
    half = _from_normal(normal, cosine, draws[:, 1])
    along = (half * view).sum(axis=1)
    mirrored = 2 * along[:, np.newaxis] * half - view
    light = (mirrored * normal).sum(axis=1)
    fits = (along > 0) & (light > 0)
    lobe = np.where(fits, whole * light / np.where(fits, along * cosine, 1.0), 0.0)
    direction = np.where(diffuse[:, np.newaxis], _diffuse(normal, draws), mirrored)
    return direction, np.where(diffuse, whole, lobe)
