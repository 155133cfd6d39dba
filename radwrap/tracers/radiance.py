"""Radiance as a tracer: scene text in a folder, a frozen octree, rtrace processes."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from radwrap.errors import InputError, TracerError
from radwrap.files import disk_failure, make_folder
from radwrap.frames import fixed_axis_angles
from radwrap.kept import Kept, of_kept
from radwrap.process import Limits, Programs
from radwrap.scene.look.wide_sources import divided
from radwrap.scene.scene import Scene
from radwrap.scene.targets import MeshPart, MeshShape, RadFile, surfaces
from radwrap.tracers.included import check_no_cycle, light_in, read_included
from radwrap.tracers.installation import Installation, judge
from radwrap.tracers.radiance_text import RadianceScene, identity_text, mesh_file, obj_text, scene_text
from radwrap.tracers.text_frame import TextFrame, traced_frame

_OCTREE: Final = "scene.oct"
# Direct light is exact and repeatable: every source once, at its centre (-ds 0, -dj 0), none left out by a
# threshold (-dt 0, -dc 1); no random reflected rays (-st 1), no interreflection (-ab 0). Light of
# sources is followed through 8 mirrors (-dr 8), also where a first look by a few rays would miss it (-dp 0). What is
# seen in mirrors is followed 8 deep (-lr 8), never by Russian roulette.
VALUE_OPTIONS: Final = tuple(
    "-h -fdf -ov -ab 0 -dt 0 -dc 1 -dj 0 -ds 0 -dr 8 -dp 0 -st 1 -lr 8 -lw 0 -n 1 -x 0 -y 0".split(" ")
)
# Interreflection point by point, no cache (-aa 0): so many ambient rays where a ray meets a surface, fewer after that.
_AMBIENT_DIVISIONS: Final = 16
_BOTH_OPTIONS: Final = tuple("-ovL" if option == "-ov" else option for option in VALUE_OPTIONS)
_SURFACE_OPTIONS: Final = tuple("-ovLN" if option == "-ov" else option for option in VALUE_OPTIONS)
_LENGTH_OPTIONS: Final = tuple("-h -fdf -oL -ab 0 -n 1 -x 0 -y 0".split(" "))
# The identity scene has no lights on purpose.
NO_LIGHT: Final = r"(rtrace|oconv): warning - no light sources found"
# Of a plane that nearly holds the text's origin: oconv found its corners even, in double precision, and a frozen octree
# keeps 31 bits of them.
_ROUNDED: Final = r'rtrace: warning - non-planar vertex for polygon ".*"'
_CHANNELS: Final = {"red": 0, "green": 1, "blue": 2}
# What rtrace says of a ray that meets nothing: 1e10 in the scene's unit, a float32.
_NOWHERE: Final = 9.9e9
# The channels of a gray scene agree to the float32's last digits.
_CHANNEL_TOLERANCE: Final = 1e-5


@dataclass(frozen=True, slots=True)
class RadianceOptions:
    """How Radiance is used.

    Attributes
    ----------
    installation : Installation
        Which Radiance.
    trusted : bool
        Whether included files may run commands and name any file.
    limits : Limits
        Time and memory of each program.
    """

    installation: Installation
    trusted: bool = False
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True, slots=True)
class PreparedScene:
    """Scene text and files, ready to be laid into a folder.

    Attributes
    ----------
    scene : RadianceScene
        Text and files of what is to be rendered.
    identity : str
        Text of the same geometry, each part glowing with its number.
    parts : tuple of str
        Names of the parts; the first has the number 1.
    included : Mapping[str, str]
        Target name -> text of an included file.
    shining_files : tuple of str
        Names of the targets whose files hold light of their own.
    """

    scene: RadianceScene
    identity: str
    parts: tuple[str, ...]
    included: Mapping[str, str]
    shining_files: tuple[str, ...]

    def lit_by(self, scene: Scene, source: str) -> RadianceScene:
        """The same text and files with one source or LED alone; the others are black."""
        return self.in_light(scene, {source})

    def in_light(self, scene: Scene, sources: Collection[str]) -> RadianceScene:
        """The same geometry, of materials that may differ, in the light of some sources or LEDs; others are black."""
        return scene_text(scene, self.included, self.scene.files, self.scene.frame, only=sources)


def prepare(
    scene: Scene,
    options: RadianceOptions,
    programs: Programs,
    folder: Path,
    stem: str = "scene",
    *,
    frame: TextFrame | None = None,
    with_outlines: bool = False,
    kept: Kept | None = None,
) -> PreparedScene:
    """Write a scene for Radiance, with the files that it includes.

    Parameters
    ----------
    scene : Scene
        What is there.
    options : RadianceOptions
        Which Radiance; whether included files are trusted.
    programs : Programs
        Owner of the processes.
    folder : Path
        A working folder.
    stem : str
        What the names of the files beside the text begin with.
    frame : TextFrame, optional
        Origin and units of the text; default `traced_frame`.
    with_outlines : bool
        Whether outlines of wide sources shine as they are, for a comparison with a tracer that has the same; else the
        patches that they need.
    kept : Kept, optional
        Where meshes are looked up that were compiled before, and kept.

    Raises
    ------
    InputError
        If an included file breaks the trust rule, nothing shines, or a wide source needs too many patches.
    TracerError
        If Radiance does not accept an included file.
    """
    scene = scene if with_outlines else divided(scene)
    texts: dict[str, str] = {}
    glowing: dict[str, str] = {}
    files: dict[str, bytes] = {}
    lit = any(emitter.radiance > 0 for emitter in scene.emitters)
    shining = []
    frame = frame or traced_frame(scene)
    for target in scene.included:
        with _naming(f"{scene.origin}: targets[{scene.targets.index(target)}].rad"):
            text, beside, has_light = _included(scene, target, options, programs, stem)
            if has_light:
                shining.append(target.name)
            files.update(beside)
            move = _move(target, frame)
            texts[target.name] = _xform(text, move, options, programs, folder)
            glowing[target.name] = _xform(text, ["-m", target.name, *move], options, programs, folder)
    if not (lit or shining):
        raise InputError("there is no light", where=f"{scene.origin}: sources", remedy="add [[sources]]")
    for part in scene.targets:
        for surface in surfaces(part) if isinstance(part, MeshPart) else ():
            if isinstance(surface.shape, MeshShape):
                where = f'{scene.origin}: target "{surface.name}"'
                files[mesh_file(stem, surface.name)] = of_kept(
                    kept,
                    partial(_mesh_key, surface.shape, frame, options),
                    partial(compiled_mesh, surface.shape, frame, options, programs, folder, where=where),
                    len,
                )
    identity, parts = identity_text(scene, glowing, frame, stem)
    return PreparedScene(scene_text(scene, texts, files, frame, stem), identity, parts, texts, tuple(shining))


def _mesh_key(shape: MeshShape, frame: TextFrame, options: RadianceOptions) -> tuple[object, ...]:
    vertices, faces = (hashlib.sha256(array.tobytes()).digest() for array in (shape.vertices, shape.faces))
    return "mesh", vertices, faces, frame, options.installation


def compiled_mesh(
    shape: MeshShape, frame: TextFrame, options: RadianceOptions, programs: Programs, folder: Path, *, where: str
) -> bytes:
    """Triangles as the file that Radiance's ``mesh`` opens.

    Raises
    ------
    TracerError
        If obj2mesh fails or warns.
    """
    with _naming(where):
        made, said = programs.run(
            [options.installation.program("obj2mesh")],
            folder=folder,
            environment=options.installation.environment(),
            stdin=[obj_text(shape, frame)],
            limits=options.limits,
        )
        judge(said, "obj2mesh")
        if not made:
            raise TracerError("wrote nothing", where="obj2mesh")
    return made


@contextmanager
def _naming(where: str) -> Generator[None]:
    """Say of a tracer's failure which included file it is about."""
    try:
        yield
    except TracerError as error:
        raise TracerError(f"{error.where}: {error.what}", where=where, remedy=error.remedy) from error


def _included(
    scene: Scene, target: RadFile, options: RadianceOptions, programs: Programs, stem: str
) -> tuple[str, Mapping[str, bytes], bool]:
    index = scene.targets.index(target)
    where = f"{scene.origin}: targets[{index}].rad"
    path = scene.folder / target.file
    if not options.trusted:
        checked = read_included(
            path,
            folder=scene.folder,
            library=options.installation.library,
            prefix=f"{stem}.include{index}",
            where=where,
        )
        return checked.text, checked.files, checked.has_light
    if not path.is_file():
        raise InputError(f'no file "{target.file}"', where=where)
    check_no_cycle(path, where=where)
    # Commands of a trusted file run in its own folder, as its author expects.
    text = _run_xform([f"./{path.name}"], b"", options, programs, path.parent.absolute())
    return text, {}, light_in(text)


def _move(target: RadFile, frame: TextFrame) -> list[str]:
    """Transform arguments: scale, then rotations about fixed x, y, z, then position."""
    x, y, z = (float(np.degrees(angle)) for angle in fixed_axis_angles(target.pose.rotation))
    place = [repr(value) for value in frame.point(target.pose.position)]
    return ["-s", repr(target.length_unit * frame.units), "-rx", repr(x), "-ry", repr(y), "-rz", repr(z), "-t", *place]


def _xform(text: str, arguments: list[str], options: RadianceOptions, programs: Programs, folder: Path) -> str:
    return _run_xform(arguments, text.encode(), options, programs, folder)


def _run_xform(arguments: list[str], stdin: bytes, options: RadianceOptions, programs: Programs, folder: Path) -> str:
    program = options.installation.program("xform")
    output, said = programs.run(
        [program, *arguments],
        folder=folder,
        environment=options.installation.environment(commands=options.trusted),
        stdin=[stdin],
        limits=options.limits,
    )
    judge(said, "xform")
    lines = output.decode(errors="replace").splitlines(keepends=True)
    # It tells its own place and arguments, of which a scene's text must not depend.
    return "".join(line for line in lines if not line.startswith((f"# {program} ", "# xform ")))


@dataclass(frozen=True, slots=True)
class RadianceTracer:
    """A frozen octree and how to ask it; satisfies `Tracer`.

    Attributes
    ----------
    options : RadianceOptions
        Which Radiance, and its limits.
    programs : Programs
        Owner of the processes.
    folder : Path
        Working folder with the octree and its files.
    scene : RadianceScene
        For the frame of its text.
    search : tuple of Path
        Further folders for files that a trusted scene names.
    channel : str
        Which of the three channels is asked for; "equal" demands that they agree.
    harmless : tuple of str
        Warnings that may be passed over, see `judge`.
    bounces : int
        How often light may go from one surface to another: with more than none, radiance is a random draw, whose mean
        is right.
    """

    options: RadianceOptions
    programs: Programs
    folder: Path
    scene: RadianceScene
    search: tuple[Path, ...] = ()
    channel: str = "equal"
    harmless: tuple[str, ...] = ()
    bounces: int = 0

    def trace(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Radiance along rays, one rtrace process for all of them; see `Tracer.trace`."""
        with closing(self._ask([*VALUE_OPTIONS, *self._ambient], rays, 3)) as answers:
            yield from map(self._radiance, answers)

    def trace_with_distances(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Radiance and distance along rays, one rtrace process for all of them; see `Tracer`."""
        with closing(self._ask([*_BOTH_OPTIONS, *self._ambient], rays, 4)) as answers:
            for values in answers:
                yield self._radiance(values[:, :3]), self._distance(values[:, 3])

    def surfaces(
        self, rays: Iterable[NDArray[np.float64]]
    ) -> Generator[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
        """Radiance along rays, distance to the first surface [m], and its normal, shape (n, 3); blocks as in `trace`.

        Where there is no surface the distance is infinite and the normal zero.
        """
        with closing(self._ask(_SURFACE_OPTIONS, rays, 7)) as answers:
            for values in answers:
                yield self._radiance(values[:, :3]), self._distance(values[:, 3]), values[:, 4:].astype(np.float64)

    @property
    def _ambient(self) -> list[str]:
        if not self.bounces:
            return []
        # With -u+, its default, random numbers would begin from the time of day.
        return f"-u- -ab {self.bounces} -aa 0 -ad {_AMBIENT_DIVISIONS} -as 0".split(" ")

    def _radiance(self, values: NDArray[np.float32]) -> NDArray[np.float64]:
        if values.min(initial=0.0) < 0:
            raise TracerError("answered a negative radiance", where="rtrace")
        return self._one_channel(values).astype(np.float64) * self.scene.frame.radiance

    def distances(self, rays: Iterable[NDArray[np.float64]]) -> Generator[NDArray[np.float64]]:
        """Distance to the first surface along rays [m]; blocks as in `trace`."""
        with closing(self._ask(_LENGTH_OPTIONS, rays, 1)) as answers:
            yield from (self._distance(values[:, 0]) for values in answers)

    def _distance(self, lengths: NDArray[np.float32]) -> NDArray[np.float64]:
        if lengths.min(initial=np.inf) <= 0:
            raise TracerError("answered a distance that is not positive", where="rtrace")
        return np.where(lengths < _NOWHERE, lengths.astype(np.float64) * self.scene.frame.length, np.inf)

    def _one_channel(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        if self.channel in _CHANNELS:
            return values[:, _CHANNELS[self.channel]]
        red, *others = values.T
        if any((abs(other - red) > _CHANNEL_TOLERANCE * red).any() for other in others):
            raise InputError(
                "the scene is coloured: the tracer's three channels differ",
                where="camera.sensor.channel",
                remedy='choose the one that the sensor sees: "red", "green" or "blue"',
            )
        return values[:, 0]

    def _ask(
        self, arguments: Iterable[str], rays: Iterable[NDArray[np.float64]], width: int
    ) -> Generator[NDArray[np.float32]]:
        """Send blocks of rays, yield blocks of answers of `width` floats a ray."""
        sent = _Sent(rays, self.scene.frame)
        said: list[str] = []
        received = bytearray()
        answered = 0
        stream = self.programs.stream(
            [self.options.installation.program("rtrace"), *arguments, _OCTREE],
            folder=self.folder,
            environment=self.options.installation.environment(self.search, commands=self.options.trusted),
            stdin=sent,
            said=said,
            limits=self.options.limits,
        )
        with closing(stream):  # an error here ends the program now, not when the generator is collected
            for part in stream:
                received += part
                answered += len(part)
                if answered > 4 * width * sent.rays:
                    raise TracerError("printed too much: more numbers than rays", where="rtrace")
                while sent.blocks and len(received) >= (size := 4 * width * sent.blocks[0]):
                    sent.blocks.popleft()
                    values = np.frombuffer(received[:size], dtype=np.float32).reshape(-1, width)
                    del received[:size]
                    if not np.isfinite(values.sum(dtype=np.float64)):
                        raise TracerError("answered NaN or infinity", where="rtrace")
                    yield values
        judge(said[0], "rtrace", (*self.harmless, _ROUNDED))
        if answered != 4 * width * sent.rays:
            raise TracerError(f"its answer is {4 * width * sent.rays - answered} bytes short", where="rtrace")


class _Sent:
    """Rays on their way into rtrace, as bytes; knows what was sent. Read by one thread, asked by another."""

    def __init__(self, rays: Iterable[NDArray[np.float64]], frame: TextFrame) -> None:
        self._source = rays
        self._frame = frame
        self.blocks: deque[int] = deque()
        self.rays = 0

    def __iter__(self) -> Iterator[memoryview]:
        for block in self._source:
            placed = block.astype(np.float64)  # a copy: the caller keeps the world's places
            placed[:, :3] = self._frame.points(placed[:, :3])
            if not np.isfinite(placed.sum()):
                raise ValueError("a ray holds NaN or infinity")  # rtrace would answer nothing, without an error
            self.blocks.append(len(block))
            self.rays += len(block)
            yield placed.data


def build(
    text: str,
    files: Mapping[str, bytes],
    folder: Path,
    options: RadianceOptions,
    programs: Programs,
    *,
    search: tuple[Path, ...] = (),
    harmless: tuple[str, ...] = (),
) -> None:
    """Lay a scene's files into a folder and freeze its octree.

    Only the frozen octree is used afterwards: an unfrozen one would run the
    commands of a trusted file again at each start of rtrace.

    Raises
    ------
    TracerError
        If oconv fails or warns.
    """
    for name, content in files.items():
        make_folder((folder / name).parent)
        _lay(folder / name, content)
    octree, said = programs.run(
        [options.installation.program("oconv"), "-f", "-"],
        folder=folder,
        environment=options.installation.environment(search, commands=options.trusted),
        stdin=[text.encode()],
        limits=options.limits,
    )
    judge(said, "oconv", harmless)
    _lay(folder / _OCTREE, octree)


def _lay(path: Path, content: bytes) -> None:
    """Write a file that lives only as long as the run."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise disk_failure(path, error) from error
