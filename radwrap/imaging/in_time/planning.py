"""What a scene that changes in the course of its exposure is rendered as, before a ray is traced."""

from __future__ import annotations

from dataclasses import dataclass, replace

from radwrap.imaging.in_time.making import refuse_for_time, steady
from radwrap.imaging.in_time.moving import planned_instants, tracer_of_many
from radwrap.imaging.render_options import RenderOptions
from radwrap.scene.instants import averaged, held, lit_by, row_levels
from radwrap.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class Planned:
    """Renders of scenes that know one instant.

    Attributes
    ----------
    still : Scene
        The first of them, of all rows.
    options : RenderOptions
        How it is rendered.
    instants : int
        So many more, at least: of what moves, at instants, of the rows in which they count and to larger errors.
    """

    still: Scene
    options: RenderOptions
    instants: int = 0


def planned(scene: Scene, options: RenderOptions) -> Planned:
    """The renders of a scene, whether it changes in time or not.

    Raises
    ------
    InputError
        If it cannot be rendered as the options ask.
    """
    refuse_for_time(scene, options)
    if (still := steady(scene, basis=options.basis)) is not None:
        return Planned(still, options)
    if not scene.motions and not options.bounces:
        largest = {name: float(level.max()) for name, level in row_levels(scene).items()}
        return Planned(lit_by(held(scene), largest), replace(options, basis=True))
    how = replace(options, basis=False, tracer=tracer_of_many(scene, options.tracer))
    return Planned(averaged(scene), how, planned_instants(scene, options.seed))
