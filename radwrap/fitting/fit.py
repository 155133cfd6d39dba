"""``fit``: from a scene and captures to values, their covariance and a verdict."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError, ToleranceNotMet
from radwrap.files import check_not_others, check_results, make_folder, sole_owner
from radwrap.fitting.approach import COARSER, approached
from radwrap.fitting.captured import Captured, read_mask
from radwrap.fitting.covariance import GRAIN, RANK, PredictionErrors, Shared, Spread, inverse_of, spread
from radwrap.fitting.directions import in_words
from radwrap.fitting.free_keys import FreeKey, FreeScene, free_scene
from radwrap.fitting.light import FEW, REPLICATES, Light
from radwrap.fitting.page import FILES, RESIDUAL, write_fit
from radwrap.fitting.places import Places, need_renders
from radwrap.fitting.poses import PREFIX, aimed_keys, mirrored_turns
from radwrap.fitting.prediction import Prediction
from radwrap.fitting.rays_needed import rays_needed
from radwrap.fitting.scene_text import text_of, with_values
from radwrap.fitting.series import Captures, State, joined, states_of
from radwrap.fitting.settled import Grained, Settled
from radwrap.fitting.solution import Solution, settle, solve
from radwrap.fitting.suspects import Suspect, suspects
from radwrap.fitting.told import Fit, FittedKey, as_manifest
from radwrap.fitting.verdict import Verdict, verdict
from radwrap.fitting.weights import patterns
from radwrap.images import GrayImage
from radwrap.imaging.relight.relit import Basis
from radwrap.imaging.relight.source_images import SourceImages
from radwrap.imaging.render_options import RenderOptions
from radwrap.imaging.response.sensor import gray_levels, image_of_levels
from radwrap.manifest import SCHEMA_VERSION, sha256_of_value, versions
from radwrap.reading import FileKind, read_text
from radwrap.scene.file.load import load_scene
from radwrap.scene.instants import refuse_time
from radwrap.scene.scene import Scene

Array = NDArray[np.float64]
_SCENE_FILE: Final = FileKind("scene file", 16 << 20, "")
_NOTHING: Final[Mapping[str, Any]] = {}
_AT_BOUND: Final = 1e-6  # of a key's scale
_WORK: Final = ".fit"
_NEAR: Final = "near"
_ROUGHEST: Final = 4.0  # times as large cells, from afar
_ROUGHER: Final = 2.0  # the same near the end
_MORE: Final = REPLICATES / FEW  # times less is grain, by squares
_FINER: Final = 6.0  # the same by cells that are not so large: 3 to 10 on six scenes
_FEWER: Final = 4  # times fewer rays at the first of these places, and while steps lead beyond what slopes reach
_FEW_PLACES: Final = 12  # at most, by so few rays
_PLACES: Final = 6  # at most by all rays, where it is looked for the end
_ARRIVED: Final = 0.1  # expected deviations along each direction: a last step adds a hundredth to their square
_SLOPE_OFF: Final = 0.1  # of a step, by the grain that slopes of few rays may have
PACKAGES: Final = ("tomlkit",)


def fit(
    scene: Scene | str | Path,
    captures: Sequence[str | Path | GrayImage] | Sequence[Captures],
    free: Sequence[str],
    out: str | Path | None = None,
    options: RenderOptions | None = None,
    *,
    changes: Mapping[str, Any] = _NOTHING,
    noise: float | None = None,
    mask: str | Path | NDArray[np.bool_] | None = None,
    robust: bool = False,
) -> Fit:
    """Find values of scene keys for which the prediction agrees with captures.

    Levels of sources, the exposure time and the sensor's electronics follow from one light basis without a ray; other
    numbers and poses take renders by the same rays.

    Parameters
    ----------
    scene : Scene, str or Path
        Where the fit begins, or its file, whose text `out` gets back with the values that were found.
    captures : sequence of str, Path or GrayImage, or sequence of Captures
        Images of this very scene, of which several are repeats; or `Captures`, each of the bench in a state of its own,
        that share the values of the free keys.
    free : sequence of str
        ``KEY`` or ``KEY=low:high``, as in the scene file; ``[*]`` frees each entry of a list by itself;
        ``pose:camera`` and ``pose:NAME`` are six numbers about the scene's pose.
    out : str or Path, optional
        Folder for fit.json, scene.toml, residual.png, residual.exr and index.html.
    options : RenderOptions, optional
        How the scene is rendered: tracer, method, diffraction and bounces are decided once.
    changes : Mapping, optional
        Keys of the scene with other values, as of `load_scene`; of a scene file only.
    noise : float, optional
        Standard deviation of one capture [gray level]; default that of the linear sensor, or the scatter of repeats.
    mask : str, Path or ndarray of bool, optional
        Pixels that count: those that are not black.
    robust : bool
        Whether single pixels that are far off count less.

    Returns
    -------
    Fit
        Values, covariance, directions that are not determined, residual and verdict.

    Raises
    ------
    InputError
        If a key cannot be fitted, a capture is not one of the scene's sensor, or no noise is known.
    ToleranceNotMet
        If the best lies at infinity.

    Examples
    --------
    >>> import radwrap
    >>> scene = radwrap.load_scene("scene.toml", {"camera.sensor.scale": "1/8"})
    >>> dimmer = radwrap.with_value(scene, "camera.exposure_time", "180 ms")
    >>> photograph = radwrap.render(dimmer, tolerance=1).gray
    >>> coarse = radwrap.RenderOptions(tolerance=2)
    >>> found = radwrap.fit(scene, [photograph], ["camera.exposure_time=0.05 s:1 s"], options=coarse, noise=1.0)
    >>> abs(found.scene.camera.exposure_time - 0.18) < 0.01
    True
    """
    options = options or RenderOptions()
    text: str | None = None
    if not isinstance(scene, Scene):
        path = Path(scene)
        text, scene = read_text(path, _SCENE_FILE), load_scene(path, changes)
    elif changes:
        raise InputError("goes with a scene file", where="changes", remedy="use `with_value`")
    if noise is not None and not (math.isfinite(noise) and noise >= 0):
        raise InputError("must be a number of 0 or more", where="noise")
    refuse_time(scene, "a fit")
    begun = free_scene(scene, free)
    counted = read_mask(mask) if isinstance(mask, str | Path) else mask
    states = states_of(begun, captures, counted, noise)
    rendered = tuple(map(any, zip(*(need_renders(state.free) for state in states), strict=True)))
    if out is None:
        with tempfile.TemporaryDirectory(prefix="radwrap-fit-") as work:
            return _fitted(begun, rendered, states, options, Path(work), noise=noise, robust=robust)
    folder = Path(out)
    check_results(folder, FILES)
    check_not_others(folder, FILES, RESIDUAL, "fit")
    make_folder(folder)
    with sole_owner(folder):
        # What was traced stays until the fit stands: one that was killed finds it, in the same order.
        traced = folder / _WORK
        make_folder(traced)
        made = _fitted(begun, rendered, states, options, traced, noise=noise, robust=robust)
        values = begun.written([key.value for key in made.keys])
        whole = json.loads(made.scene.document)
        written = (
            text_of(whole) if text is None else with_values(text, {**changes, **values}, aimed_keys(begun.poses), whole)
        )
        write_fit(made, written, folder)
        shutil.rmtree(traced)
    return made


def _prediction(
    states: Sequence[State],
    rendered: Sequence[bool],
    trace: Callable[[Scene], Basis | SourceImages],
    steps: Sequence[float] = (),
    *,
    rough: Prediction | None = None,
    looks: Sequence[tuple[float, Prediction]] = (),
) -> Prediction:
    """Of all states; those that differ in levels, exposure or the sensor's electronics only are seen in one light."""
    known: list[Places] = []
    shots = []
    for state in states:
        places = next((one for one in known if one.serves(state.free.scene)), None)
        if places is None:
            places = Places(state.free, rendered, trace)
            known.append(places)
        shots.append((state.free, places))
    return Prediction(shots, steps, rough, looks)


@dataclass(frozen=True, slots=True, eq=False)
class _Begin:
    """Where the fit itself begins: values, how far keys are moved for slopes, and rays so far."""

    values: Array | None = None
    steps: Sequence[float] = ()
    rays: int = 0


def _begin(rendered: Sequence[bool], states: Sequence[State], light: Light) -> _Begin:
    """Where coarse renders lead to, if any key needs renders."""
    if not any(rendered):
        return _Begin()
    keys, captures = states[0].free.keys, [state.captured for state in states]
    prediction = _prediction(states, rendered, partial(light.roughly, times=_ROUGHEST, replicates=FEW))
    values = approached(keys, prediction, captures, COARSER * light.tolerance)
    return _Begin(values, prediction.steps, light.rays)


@dataclass(frozen=True, slots=True, eq=False)
class Ended:
    """Where a fit ended: values, how far the prediction may be off there, and the grain of its slopes."""

    solved: Solution
    errors: PredictionErrors
    grained: Grained

    @property
    def grain(self) -> Array:
        """Expected D^T D of the slopes' error D, over sigma."""
        used = self.solved.weighed.used
        return self.grained.over(used, self.solved.weighed.sigma[used]).slopes

    def spread(self, share: float, shared: Shared | None) -> Spread:
        """What the captures determine, by pixels that count as much as they do in the fit."""
        solved, used = self.solved, self.solved.weighed.used
        weight = solved.weight
        return spread(
            solved.jacobian * weight[:, np.newaxis],
            self.errors.over(weight),
            share,
            None if shared is None else shared.over(weight),
            self.grained.over(used, solved.weighed.sigma[used] / weight).slopes,
            variance=solved.variance,
            left=solved.residual[used] * weight,
        )


def ended(
    keys: Sequence[FreeKey],
    prediction: Prediction,
    light: Light,
    captures: Sequence[Captured],
    begin: Array,
    *,
    noise: float | None,
    robust: bool,
) -> Ended:
    """Settle by unbiased rays where a search ended, and where that leads to once more, until it leads nowhere else.

    A step of some deviations leaves what is not linear in it: along what the captures hardly determine, keys go far.
    """
    place, scales = begin, np.array([key.scale for key in keys])
    before: Settled | None = None
    bases: list[Basis | SourceImages | None] = [None] * len(prediction.places)
    needed: list[NDArray[np.intp] | None] = [None] * len(prediction.places)
    # Where renders are compared, few rays first, by the slopes of the search: a step from there is short.
    last, whole, few = 0, 0, 0
    share = _FEWER if prediction.has_renders else 1
    while whole < _PLACES:
        traced = [
            light.unbiased(places.scene(place), share, nearby if share == last else None, rays if share == 1 else None)
            if prediction.has_renders
            else places.lit(place).basis
            for places, nearby, rays in zip(prediction.places, bases, needed, strict=True)
        ]
        may_end = share == 1 or before is not None
        bases, last = [*traced], share
        before = near = Settled(prediction, keys, place, traced, before, is_last=may_end)
        solved, grained = settle(keys, near, captures, noise, robust=robust, begin=place)
        if share > 1:
            needed = rays_needed(prediction, traced, near, solved, grained, aimed=light.aimed, share=share)
        way, bent = solved.values - place, near.bent(solved.values)
        off = bent + _SLOPE_OFF if prediction.has_renders else 0.0
        if share == 1 and off * _gone(solved, grained, way / scales) < _ARRIVED:
            break
        # No farther than slopes reach: along what is hardly seen they may lead anywhere.
        place = place + way / max(bent, 1.0)
        whole, few = whole + (share == 1), few + (share > 1)
        share = _FEWER if bent > 1 and few < _FEW_PLACES else 1
    else:  # it still goes elsewhere
        solved = replace(solved, converged=False)
    if not near.reaches(solved.values):
        solved = replace(solved, converged=False)
    used = solved.weighed.used
    sigma = solved.weighed.sigma[used]
    errors = PredictionErrors(near.errors(solved.values)[:, used] / sigma, near.common(solved.predicted)[used] / sigma)
    return Ended(solved, errors, grained)


def _gone(solved: Solution, grained: Grained, way: Array) -> float:
    """How far a step goes along each direction that the captures determine, rms, in expected deviations."""
    used = solved.weighed.used
    found = inverse_of(solved.jacobian, GRAIN, grained.over(used, solved.weighed.sigma[used]).slopes)
    return float(np.linalg.norm(solved.jacobian @ way)) / math.sqrt(max(found.basis.shape[1], 1))


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """Where one way led to: an end, what is to be said of it, and rounds that it took."""

    ended: Ended
    verdict: Verdict
    rounds: int

    @property
    def merit(self) -> tuple[bool, float]:
        """The better, the larger: explained, and how far the sums stay below their limits."""
        tests = [test for test in (self.verdict.pixels, self.verdict.blocks) if test is not None and test.is_judged]
        worst = max((test.chi_square / test.largest for test in tests), default=0.0)
        return self.verdict.explained, -worst


def with_other_tilts(
    free: FreeScene, first: Arrival, go: Callable[[Array | None], Arrival]
) -> tuple[Arrival, list[dict[str, Any]]]:
    """Begin again where an end is refused and a target's pose is free: it may be tilted as much the other way.

    From afar both tilts look nearly alike, and no small step leads from one to the other.

    Parameters
    ----------
    free : FreeScene
        What is free.
    first : Arrival
        The end that was found.
    go : callable
        Leads from values to an end.

    Returns
    -------
    Arrival, list
        The better end, and of each new beginning its pose and whether it was kept.
    """
    best, told = first, []
    for pose in free.poses:
        if best.verdict.explained or not best.verdict.is_judged or not pose.is_target:
            continue
        values = best.ended.solved.values
        scene = free.at([float(value) for value in values])
        now = next(target.pose for target in scene.targets if target.name == pose.name)
        turns = mirrored_turns(pose, now, scene.camera.pose.position)
        begin = [turns.get(key.key, float(value)) for key, value in zip(free.keys, values, strict=True)]
        try:
            other = go(np.array(begin))
        except (InputError, ToleranceNotMet):  # the scene is none there: nothing is lost
            continue
        told.append({"pose": f"{PREFIX}{pose.name}", "kept": other.merit > best.merit})
        best = max(best, other, key=lambda one: one.merit)
    return best, told


def _shared(solved: Solution, noise: float | None) -> Shared | None:
    """What pixels of one specimen differ by, in all captures of several; None where each pixel is seen once."""
    parts = solved.predicted.parts
    if len(parts) == 1 or noise is not None or parts[0].sensor.linear is None:
        return None
    used, sigma = solved.weighed.used, solved.weighed.sigma
    deviations = np.concatenate([patterns(part.exposure, part.sensor) for part in parts], axis=1)
    pixel = np.tile(np.arange(parts[0].exposure.size).reshape(parts[0].exposure.shape), (len(parts), 1))
    return Shared(deviations[:, used] / sigma[used], pixel[used])


def _fitted(
    free: FreeScene,
    rendered: Sequence[bool],
    states: Sequence[State],
    options: RenderOptions,
    work: Path,
    *,
    noise: float | None,
    robust: bool,
) -> Fit:
    light = Light(states[0].free.scene, options, work, is_even=any(rendered))
    begin, taken = _begin(rendered, states, light), 0
    if begin.values is not None and begin.values.tolist() != [key.value for key in free.keys]:
        # Rays are planned where the values are: a target that was out of sight may have come into it.
        near = work / _NEAR
        make_folder(near)
        taken = begin.rays
        light = Light(states[0].free.at(begin.values.tolist()), options, near, is_even=True)
    captures = [state.captured for state in states]
    search, looks = None, []
    if any(rendered):  # the way is sought by few rays: what these are off by is settled at its end
        rough = partial(light.roughly, times=_ROUGHER)
        search = _prediction(states, rendered, partial(rough, replicates=FEW), begin.steps)
        more = ((_MORE, partial(rough, replicates=REPLICATES)), (_FINER, partial(light.at, replicates=FEW)))
        looks = [(less, _prediction(states, rendered, trace, rough=search)) for less, trace in more]
    prediction = _prediction(states, rendered, light.at if search else light.unbiased, rough=search, looks=looks)
    off = _ROUGHER * light.tolerance
    share = GRAIN if prediction.has_renders else RANK
    numbers = [state.number for state in states]

    def go(begin: Array | None) -> Arrival:
        sought = solve(free.keys, search or prediction, captures, noise, robust=robust, begin=begin, tolerance=off)
        found = ended(free.keys, prediction, light, captures, sought.values, noise=noise, robust=robust)
        end = found.solved
        # The verdict counts all pixels alike.
        alike = inverse_of(end.jacobian, share, found.grain).basis
        judged = verdict(end.residual, end.weighed.sigma, alike, found.errors, of_capture=numbers)
        return Arrival(found, judged, sought.rounds + end.rounds)

    arrived, again = with_other_tilts(free, go(begin.values), go)
    found, judged, solved = arrived.ended, arrived.verdict, arrived.ended.solved
    used, sigma = solved.weighed.used, solved.weighed.sigma
    sure = found.spread(share, _shared(solved, noise))
    parts = solved.predicted.parts
    looks_like = () if judged.explained or not judged.is_judged else _suspects(free.keys, found, share)
    scales = np.array([key.scale for key in free.keys])
    keys = tuple(
        _key(key, float(value), sure, number)
        for number, (key, value) in enumerate(zip(free.keys, solved.values, strict=True))
    )
    lost = np.isnan(sure.half_width)
    gone = lost[:, np.newaxis] | lost[np.newaxis]
    covariance = np.where(gone, np.nan, sure.covariance * np.outer(scales, scales))
    correlation = np.where(gone, np.nan, sure.correlation)
    words = in_words(sure.null, [key.key for key in free.keys], solved.values, scales)
    scene = free.at([float(value) for value in solved.values])
    levels = [gray_levels(part.exposure, part.sensor) for part in parts]
    grays = tuple(image_of_levels(image, parts[0].sensor, {}) for image in joined(levels, states))
    residual, deviation = (
        np.concatenate(joined(np.split(image, len(states)), states)) for image in (solved.residual, sigma)
    )
    censored = int(np.count_nonzero(solved.weighed.censored))
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "versions": versions(*PACKAGES),
        "scene_sha256": sha256_of_value(scene),
        "scene": json.loads(scene.document),
        "captures": [told for state in states for told in state.told],
        "noise": noise,
        "robust": robust,
        "held": light.held(),
        "rays": light.rays + taken,
        "places": prediction.renders,
        "left_out": light.left_out,
        "converged": solved.converged,
        "rounds": arrived.rounds,
        "begun_again": again,
        "used_pixels": int(np.count_nonzero(used)),
        "censored_pixels": censored,
        "undetermined": words,
        **as_manifest(keys, judged, covariance, correlation),
        "looks_like": [asdict(one) for one in looks_like],
    }
    return Fit(
        scene,
        keys,
        covariance,
        correlation,
        tuple(words),
        judged,
        looks_like,
        solved.converged,
        residual,
        deviation,
        grays,
        censored,
        manifest,
    )


def _suspects(keys: Sequence[FreeKey], ended: Ended, share: float) -> tuple[Suspect, ...]:
    """What is left looks like. A key at its bound does not do what a suspect does: it is held."""
    solved = ended.solved
    held = [_at_bound(key, float(value)) for key, value in zip(keys, solved.values, strict=True)]
    moving = inverse_of(np.where(held, 0.0, solved.jacobian), share, ended.grain).basis
    return suspects(solved.predicted.parts, solved.residual, solved.weighed.sigma, moving, ended.errors)


def _at_bound(key: FreeKey, value: float) -> bool:
    near = _AT_BOUND * key.scale
    return value <= key.low + near or value >= key.high - near


def _key(key: FreeKey, value: float, sure: Spread, number: int) -> FittedKey:
    half, scale = float(sure.half_width[number]), key.scale
    at_bound = _at_bound(key, value)
    if math.isnan(half):
        return FittedKey(key.key, key.unit, key.value, value, None, None, None, None, at_bound)
    noise, rays = (scale * math.sqrt(part[number, number]) for part in (sure.noise, sure.prediction))
    interval = value - scale * half, value + scale * half
    return FittedKey(key.key, key.unit, key.value, value, math.hypot(noise, rays), interval, noise, rays, at_bound)
