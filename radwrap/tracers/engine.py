"""What makes tracers of a scene: whichever ray tracer stands behind the waist, the same is asked of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from enum import IntEnum
from typing import Final, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from radwrap.scene.scene import Scene
from radwrap.tracers.bouncing import SURE_STEPS, Reflecting
from radwrap.tracers.tracer import Tracer

EngineName = Literal["radiance", "compiled"]
ENGINES: Final[tuple[EngineName, ...]] = get_args(EngineName)


class BlockLight(IntEnum):
    """What is known of the light on a block of an image.

    Attributes
    ----------
    UNKNOWN
        Nothing.
    LIKELY
        Only a flat face is seen in it, of one material, wholly, with nothing near. Each place of it gets the light of
        each small source, and of wide ones what something may hide in part: mostly it changes smoothly.
    PROVED
        Only a flat face is seen in it, matte or with a broad lobe. Each place gets the light of the same small sources,
        and of wide ones wholly: it can only change smoothly.
    """

    UNKNOWN = 0
    LIKELY = 1
    PROVED = 2


# Rays through corners and middles of blocks of an image, and each block's corners -> each block's `BlockLight`.
Prover = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.intp]], NDArray[np.int8]]


class Engine(Protocol):
    """A ray tracer, and a scene that was laid out for it."""

    @property
    def name(self) -> EngineName:
        """Which ray tracer."""
        ...

    @property
    def versions(self) -> Mapping[str, str]:
        """Versions of what its answers depend on, besides Radiance, which is the reference of all."""
        ...

    @property
    def cpu_s(self) -> float:
        """CPU time that its tracers have used in this process so far [s]."""
        ...

    def tracer(self, scene: Scene, lit: Collection[str] | None = None, *, name: str = "scene") -> Tracer:
        """A tracer of the scene.

        Parameters
        ----------
        scene : Scene
            That was laid out; its materials may differ.
        lit : collection of str, optional
            Names of the sources and LEDs that shine; the others are black then. Default all.
        name : str
            For its working folder, if it needs one: one for each tracer.

        Raises
        ------
        EnvironmentFailure
            If the ray tracer does not accept the scene.
        """
        ...

    def by_source(self, names: Sequence[str]) -> Tracer | None:
        """A tracer that tells sources or LEDs apart in one pass, if there is any.

        Its radiances have the shape (names, n): the light of each alone,
        the others black. What has none of these names is dark.
        """
        ...

    def bouncing(
        self,
        scene: Scene,
        materials: tuple[Reflecting | None, ...],
        orders: int | None,
        sure_steps: int = SURE_STEPS,
    ) -> Tracer:
        """A tracer that adds what surfaces reflect to each other; see `bouncing.BouncingTracer`.

        Parameters
        ----------
        scene : Scene
            That was laid out.
        materials : tuple of Lambertian, Specular or None
            Of the parts with a number, from 1; None of what reflects nothing.
        orders : int or None
            How often light is reflected at most on its way; None for no limit.
        sure_steps : int
            So far no walk ends by chance.
        """
        ...

    def numbered(self) -> Tracer:
        """A tracer of the numbers of parts whose fronts rays meet first; 0 of backs and of nothing."""
        ...

    @property
    def smooth_blocks(self) -> Prover | None:
        """Who can prove that light changes smoothly within blocks of an image, if anybody.

        It is asked with rays through the blocks' corners, shape (corners, 6),
        and through their middles, shape (n, 6), all from one point, and with
        the numbers of each block's corners, one beside the next, shape (n, 4).
        It answers with a `BlockLight` for each block.
        """
        ...
