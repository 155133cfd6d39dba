"""Compiling ahead: so that no image waits for it."""

from __future__ import annotations

from typing import Final

import numpy as np

from radwrap.frames import Pose
from radwrap.scene.materials import Lambertian
from radwrap.scene.targets import Sheet
from radwrap.tracers.compiled.along_curve import along_curve
from radwrap.tracers.compiled.arrays import Cluster, Light, Wide, rows
from radwrap.tracers.compiled.before import may_hide, nothing_before
from radwrap.tracers.compiled.compiler import cache_folder
from radwrap.tracers.compiled.cover_rows import Wardrobe
from radwrap.tracers.compiled.layout import CompiledScene, clusters_of
from radwrap.tracers.compiled.shape_rows import sorted_shapes
from radwrap.tracers.compiled.shine import side_by_side
from radwrap.tracers.compiled.smooth import smooth_blocks
from radwrap.tracers.compiled.tracer import CompiledTracer
from radwrap.tracers.compiled.walker import WalkingTracer
from radwrap.tracers.text_frame import TextFrame

# Functions that programs call, each of which brings with it those that it calls.
_KEPT: Final = (
    "kernels.meet",
    "along_curve.put_keys",
    "kernels.trace",
    "kernels.surfaces",
    "walks.go_on",
    "tree._grow",
    "smooth._met",
    "smooth._undisturbed",
    "outlines.settle",
)


def is_warm() -> bool:
    """Whether everything is compiled, as far as the folder of compiled functions tells."""
    return all(any(cache_folder().rglob(f"{name}-*.nbc")) for name in _KEPT)


def warm_up() -> None:
    """Compile what is not compiled yet, by a scene of one sheet without light."""
    frame, tables = TextFrame(), [0.0]
    wardrobe = Wardrobe({"gray": Lambertian(0.5)}, frame, tables)
    sheet = Sheet("sheet", Pose(), "gray", 1.0, 1.0)
    lights = rows(Light, 0)
    may_hide(lights, np.empty((0, 3)), np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    clusters, parts = clusters_of(lights)
    scene = CompiledScene(
        targets=sorted_shapes(wardrobe.pieces(sheet), frame, tables),
        emitters=sorted_shapes([], frame, tables),
        covers=wardrobe.covers,
        decals=wardrobe.decals,
        lights=lights,
        beside=side_by_side(lights),
        clusters=clusters,
        parts_of_clusters=parts,
        wides=rows(Wide, 0),
        cells=rows(Cluster, 0),
        pitch=1.0,
        background=0.0,
        tables=np.array(tables),
        parts=("sheet.surface",),
        part_of_cover=np.array([1]),
        part_of_light=np.zeros(0, dtype=np.int64),
        members=(),
        skies=(),
        whole=(),
        frame=frame,
    )
    tracer, ray = CompiledTracer(scene), np.array([[0.0, 0.0, 1.0, 0.0, 0.0, -1.0]])
    next(tracer.trace([ray]))
    next(tracer.distances([ray]))
    next(WalkingTracer(tracer, np.zeros((1, 3)), 1, 0).trace([ray]))
    smooth_blocks(scene, np.tile(ray, (4, 1)), ray, np.arange(4)[np.newaxis])
    # What only scenes with lights ask.
    nothing_before(rows(Wide, 1)[0], scene.targets, scene.emitters)
    along_curve(scene.targets.nodes, ray, *frame.origin, float(frame.units), np.ones(1), np.zeros(1, dtype=np.int64))
