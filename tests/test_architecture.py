"""The layout is a promise: data flows one way, and each foreign package has one door."""

import ast
import gc
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import radwrap

PACKAGE = Path(radwrap.__file__).parent

# Each folder may import itself, the ground, and what stands before it.
ORDER = [
    "ground",
    "scene",
    "tracers",
    "imaging",
    "convert",
    "measure",
    "calibrate",
    "study",
    "dataset",
    "fitting",
    "designing",
    "led",
    "validate",
    "face",
    "cli",
]

# The rooms of the two largest folders, wings and modules beside them. Each may import itself and what stands before it.
ROOMS = {
    "scene": [
        "catalog",
        *(
            "zernike",
            "aberrations",
            "distortion",
            "linear_sensor",
            "pixel_window",
            "mosaic",
            "shutter",
            "camera",
            "sensor_part",
        ),
        *(
            "materials",
            "mesh",
            "wide_shapes",
            "spectrum",
            "patterns",
            "sources",
            "targets",
            "motion",
            "tolerances",
            "scene",
            "instants",
            "colour_planes",
            "bands",
        ),
        *("mesh_files", "look", "file"),
    ],
    "imaging": [
        *("response", "optics", "run_files"),
        *(
            "option_values",
            "asked_tolerance",
            "demand",
            "render_options",
            "banding",
            "tracer_choice",
            "tracing",
            "time_steps",
            "pattern_truth",
            "truth",
        ),
        *(
            "methods",
            "tolerance",
            "summed_instants",
            "mean_radiance",
            "relight",
            "forecast",
            "output",
            "wave_shares",
            "wave_rays",
            "with_waves",
            "forecasting",
            "other_camera",
            "timed_basis",
            "raw_relighting",
            "relighting",
            "page",
            "rendered",
            "mosaicked",
            "in_time",
        ),
        *("synthesis", "warm"),
    ],
}

# Who takes an image and never asks how it came about.
BLIND = {"measure": {"scene", "tracers", "imaging"}, "calibrate": {"scene", "tracers", "imaging"}}

# Formulas that judge the rest: they share no line with what they judge, and nothing that is judged uses them.
JUDGES = "radwrap.validate.closed_forms"
JUDGES_MAY = {"collections", "decimal", "math", "typing", "numpy", "scipy", "__future__"}

# Who may import a foreign package, and why just there.
BORDER = "a table of the scene file: pydantic goes no further than these"
DOORS = {
    "subprocess": {"process.py": "every program is started with a limit of time, and ended with us"},
    "OpenImageIO": {"images.py": "images are read and written in one place"},
    "cv2": {
        "calibrate/opencv_views.py": "projects, and calibrates from several views",
        "calibrate/opencv_solver.py": "the solver that Tsai's is held against, and whose models users have",
        "imaging/output/colour_picture.py": "demosaics raw images as users' software does",
        "measure/compare.py": "registration of two images: phase correlation and ECC",
        "measure/targets/opencv_detectors.py": "detectors of calibration targets",
        "measure/dots/overlay.py": "draws what was found",
        "measure/parts/overlay.py": "draws what was found",
        "measure/parts/raster.py": "labels, distances and hulls of masks",
        "scene/file/calibration_file.py": "reads what OpenCV's FileStorage wrote",
        "scene/file/pattern_convert.py": "knows the bits of OpenCV's ArUco markers",
    },
    "pydantic": {
        "scene/file/border.py": "types of the scene file's values",
        "scene/file/document.py": BORDER,
        "scene/file/faults.py": "turns pydantic's errors into ours",
        "scene/file/load.py": "reads a scene's tables, and what they left out",
        "scene/file/material_tables.py": BORDER,
        "scene/file/mosaic_tables.py": BORDER,
        "scene/file/optics_tables.py": BORDER,
        "scene/file/pattern_tables.py": BORDER,
        "scene/file/sensor_tables.py": BORDER,
        "scene/file/source_tables.py": BORDER,
        "dataset/tables.py": "tables of a dataset's file: pydantic goes no further",
        "fitting/tables.py": "tables of a file of captures: pydantic goes no further",
        "study/design_tables.py": "tables of a design file: pydantic goes no further",
        "designing/tables.py": "tables of a design problem's file: pydantic goes no further",
        "imaging/run_files.py": "ranges of numbers in what a run leaves as JSON",
        "written.py": "checks JSON that is read back",
    },
    "tomllib": {
        "reading.py": "TOML of users, judged before it is parsed",
    },
    "pydantic_core": {
        "scene/file/faults.py": "turns pydantic's errors into ours",
        "scene/file/load.py": "knows where a detail belongs, and what was left out",
    },
    "trimesh": {
        "scene/mesh_files/parts.py": "reads mesh files for scenes",
        "convert/preview_files.py": "writes binary glTF",
        "dataset/collisions.py": "finds parts that stand in each other",
    },
    "hid": {"led/ports.py": "the one way to a HID device"},
    "hidraw": {"led/ports.py": "the same, by the kernel's own driver"},
    "multiprocessing": {"study/pool.py": "workers of this machine"},
    "distributed": {"study/pool.py": "workers of a Dask cluster"},
    "starlette": {"face/app.py": "requests and answers of the page's server"},
    "uvicorn": {"face/serve.py": "the page's server"},
    "tomli_w": {"face/saving.py": "writes scene files"},
    "tomlkit": {"fitting/scene_text.py": "writes a user's scene file with its comments"},
    "optuna": {"designing/sampler.py": "which candidates a search looks at next"},
    "clarabel": {"designing/convex.py": "convex programs"},
    "webbrowser": {"cli/face.py": "opens the page"},
    "numba": {"tracers/compiled/compiler.py": "compiles our own tracer"},
    "llvmlite": {"tracers/compiled/compiler.py": "its version, for manifests"},
    "jinja2": {"study/report.py": "fills in the report of a study", "validate/report.py": "fills in the score card"},
    "pyDOE3": {"study/runs.py": "designs of experiments"},
    "statsmodels": {"study/variance.py": "analysis of variance"},
    "pandas": {"study/variance.py": "the table that statsmodels wants"},
    # These are never imported.
    "cascadio": {},  # trimesh finds it where it is installed
    "pyradiance": {},  # its programs are used; importing it changes PATH
    "EasyMCP2221": {},  # tests hold our own driver against it
    "ctypes": {},  # nothing here calls C
}
# Who writes words of the command line outside cli/, and why.
OPTION = re.compile(r"(?<![\w-])--(?:[a-z]|$)")  # also where a name follows in an f-string
SPELLERS = {
    "face/recipe.py": "the command that makes the same picture, to be copied as it is",
    "imaging/page/one_file.py": "the same",
    "imaging/page/turn.py": "the same",
    "led/connect.py": "arguments of the emulator, a program of its own",
    "led/emulator/__main__.py": "the same",
    "led/ports.py": "names a command to be copied as it is",
    "scene/file/calibration_file.py": "names a command to be copied as it is",
    "scene/look/smallness.py": "a warning of the manifest",
    "study/tolerate.py": "a note of the report",
    "study/trade_report.py": "settings, told as commands to be copied as they are",
    "study/trade_rows.py": "the same",
    "tracers/povray.py": "arguments of POV-Ray",
}
# Files that users name are read through reading.py. What else opens a file, in the words of the source, and why it may.
SHIPPED = "files('radwrap')"  # files of the package itself, which nobody names
OPENERS = {"open", "fdopen", "read_bytes", "read_text", "fromfile", "genfromtxt", "loadtxt", "memmap", "imread"}
READ_ELSEWHERE = {
    "cli/face.py": {"webbrowser.open": "the page's own link"},
    "cli/init_examples.py": {"one.read_bytes": "the package's own examples"},
    "cli/main.py": {"os.open": "the null device, for a stdout that is gone"},
    "cli/streams.py": {
        "os.fdopen": "the process's own streams",
        "os.open": "the null device, for streams that were closed",
    },
    "convert/ies_files.py": {"file.read_bytes": "what ies2rad left in a folder of our own"},
    "descendants.py": {"(place / 'environ').read_bytes": "processes of this machine"},
    "face/assets.py": {"entry.read_bytes": "the package's own files"},
    "manifest.py": {"told.read_text": "of packages that are installed"},
    "face/renderer.py": {"path.read_bytes": "what the page's server has just written"},
    "face/serve.py": {"os.open": "writes", "os.fdopen": "writes"},
    "files.py": {
        "os.open": "flushes to the disk what was just written",
        "path.open": "hashes the files that a basis lists",
        "(folder / LOCK_NAME).open": "the lock of a folder that is written to",
        "temporary.read_bytes": "reads back what was just written",
    },
    "images.py": {
        "oiio.ImageInput.open": "pictures that the door has let in, or that were just written",
        "output.open": "writes",
        "path.open": "the header of a picture that the door has let in",
        "path.read_bytes": "a PNG that was just written",
    },
    "imaging/methods/pieces.py": {"(folder / CALL_LOG).open": "appends to a log"},
    "led/claim.py": {
        "os.open": "locks, which hold nothing",
        "(process / 'cmdline').read_bytes": "processes of this machine",
        "(process / 'fdinfo' / own.name).read_text": "processes of this machine",
    },
    "led/emulator/server.py": {"self._handles.open": "a handle of the emulated device"},
    "reading.py": {"os.open": "the door", "os.fdopen": "the door"},
    "scene/mesh_files/parts.py": {"made.read_bytes": "what the STEP reader left in a folder of our own"},
    "study/journal.py": {"os.open": "appends to a table"},
    "study/report.py": {"path.read_bytes": "thumbnails of the study's own runs"},
    "study/seal.py": {
        "Path(seal.mark).read_text": "the mark that the study's runner has set",
        "entry.read_bytes": "the package's own files, for their hash",
    },
    "tracers/compiled/compiler.py": {"path.read_bytes": "its own sources, for their hash"},
    "study/worker.py": {"os.open": "appends to a log"},
    "study/user_process.py": {"os.fdopen": "the process's own stdout"},
}
LONGEST_MODULE = 500  # lines; a longer one becomes a folder


@pytest.fixture(autouse=True, scope="module")
def no_garbage() -> Iterator[None]:
    """Trees stay until the end: to look for garbage in them takes twice as long as to make them."""
    gc.disable()
    yield
    gc.enable()


@cache
def parsed(path: Path) -> ast.Module:
    """A module of the package, parsed once for all tests."""
    return ast.parse(path.read_text("utf-8"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All that stands in a module, walked once for all tests."""
    return tuple(ast.walk(parsed(path)))


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def names() -> dict[str, Path]:
    """Modules and folders of the package by the names they are imported by."""
    found = {".".join(("radwrap", *path.relative_to(PACKAGE).with_suffix("").parts)): path for path in modules()}
    return {name.removesuffix(".__init__"): path for name, path in found.items()}


def folder(name: str) -> str:
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ORDER else "ground"


def folder_of(path: Path) -> str:
    inside = path.relative_to(PACKAGE)
    return inside.parts[0] if len(inside.parts) > 1 else "ground"


@cache
def imports(path: Path) -> frozenset[str]:
    """What a module imports, anywhere in it: in functions and for type checkers as well."""
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def against_the_stream(path: Path, here: str, order: list[str], within: str) -> Iterator[str]:
    """Imports of a module in `here` that stand behind it in the order; names begin with `within`."""
    place = {room: number for number, room in enumerate(order)}
    for name in sorted(imports(path)):
        if name.startswith(within) and place.get(name.removeprefix(within).split(".")[0], -1) > place.get(here, -1):
            yield f"{path} imports {name}"


def test_data_flows_one_way() -> None:
    wrong = []
    for path in modules():
        # The few public names, and the command line as a module.
        if path not in (PACKAGE / "__init__.py", PACKAGE / "__main__.py"):
            wrong += against_the_stream(path, folder_of(path), ORDER, "radwrap.")
    assert not wrong


@pytest.mark.parametrize("large", ROOMS)
def test_within_large_folders_data_flows_one_way_too(large: str) -> None:
    wrong = []
    for path in (PACKAGE / large).rglob("*.py"):
        room = path.relative_to(PACKAGE / large).parts[0].removesuffix(".py")
        if room != "__init__":
            wrong += against_the_stream(path, room, ROOMS[large], f"radwrap.{large}.")
    assert not wrong


def test_the_rules_catch_an_import_against_the_stream(tmp_path: Path) -> None:
    offender = tmp_path / "offender.py"
    offender.write_text("def late() -> None:\n    from radwrap.imaging.forecast.explain import explain\n")
    assert list(against_the_stream(offender, "scene", ORDER, "radwrap."))
    assert list(against_the_stream(offender, "tolerance", ROOMS["imaging"], "radwrap.imaging."))
    assert not list(against_the_stream(offender, "synthesis", ROOMS["imaging"], "radwrap.imaging."))


@pytest.mark.parametrize("large", ROOMS)
def test_every_room_has_its_place_in_the_order(large: str) -> None:
    there = {path.name.removesuffix(".py") for path in (PACKAGE / large).iterdir()} - {"__init__", "__pycache__"}
    assert there == set(ROOMS[large])
    assert len(ROOMS[large]) == len(set(ROOMS[large]))


def test_every_folder_has_its_place_in_the_order() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(ORDER) - {"ground"}


def test_no_modules_import_each_other_in_a_circle() -> None:
    known = names()
    graph = {
        name: {found if found in known else found.rpartition(".")[0] for found in imports(path)} & known.keys() - {name}
        for name, path in known.items()
    }
    del graph["radwrap"]  # the few public names
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        pytest.fail(" <- ".join(circle.args[1]))


@pytest.mark.parametrize("blind", BLIND)
def test_what_takes_images_does_not_know_how_they_came_about(blind: str) -> None:
    wrong = []
    for path in (PACKAGE / blind).rglob("*.py"):
        for name in imports(path):
            # The public names at the top are those of a scene and its render.
            public = name == "radwrap" or (name.startswith("radwrap.") and name.count(".") == 1 and name not in names())
            if folder(name) in BLIND[blind] or public:
                wrong.append(f"{path}: imports {name}")
    assert not wrong


def partial_judgement(path: Path) -> Iterator[str]:
    """What a module of closed forms imports beyond mathematics and its own folder."""
    for name in sorted(imports(path)):
        if name.split(".")[0] not in JUDGES_MAY and not name.startswith(f"{JUDGES}."):
            yield f"{path} imports {name}"


def test_closed_forms_know_nothing_of_what_they_judge(tmp_path: Path) -> None:
    """In the text, and in fact: importing them all loads nothing else of radwrap, however far down."""
    judges = {name: path for name, path in names().items() if name.startswith(JUDGES)}
    assert len(judges) > 1
    assert not [wrong for path in judges.values() for wrong in partial_judgement(path)]
    code = (
        f"import importlib, sys; [importlib.import_module(name) for name in {sorted(judges)}];"
        "print(*sorted(name for name in sys.modules if name.split('.')[0] == 'radwrap'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == judges.keys() | {"radwrap", "radwrap.validate"}
    offender = tmp_path / "offender.py"
    offender.write_text("def late() -> None:\n    from radwrap.imaging.optics import falloff\n")
    assert list(partial_judgement(offender))


def test_closed_forms_are_used_by_judges_only() -> None:
    users = {folder_of(path) for path in modules() for name in imports(path) if name.startswith(JUDGES)}
    assert users == {"validate"}


def test_each_foreign_package_has_one_door() -> None:
    wrong, used = [], set()
    for path in modules():
        inside = path.relative_to(PACKAGE).as_posix()
        for package in {name.split(".")[0] for name in imports(path)} & DOORS.keys():
            used.add((package, inside))
            if inside not in DOORS[package]:
                wrong.append(f"{inside} imports {package}")
    assert not wrong
    assert used == {(package, inside) for package, doors in DOORS.items() for inside in doors}, "a door nobody uses"
    assert all(reason for doors in DOORS.values() for reason in doors.values())


def spelled(path: Path) -> Iterator[str]:
    """Strings that name options of the command line; docstrings are for people."""
    told = {id(node.value) for node in nodes(path) if isinstance(node, ast.Expr)}
    for node in nodes(path):
        text = node.value if isinstance(node, ast.Constant) and id(node) not in told else None
        if isinstance(text, str) and OPTION.search(text):
            yield text


def test_only_the_command_line_knows_its_words() -> None:
    spelling = {path.relative_to(PACKAGE).as_posix() for path in modules() if any(spelled(path))}
    assert {path for path in spelling if not path.startswith("cli/")} == SPELLERS.keys()


def openings(module: ast.Module) -> set[str]:
    """Whatever a module calls to open a file, as it stands there; the package's own data aside."""
    calls = [node.func for node in ast.walk(module) if isinstance(node, ast.Call)]
    through_the_door = {"read_bytes", "read_text"}  # as plain names they are reading.py's
    found = {
        ast.unparse(call)
        for call in calls
        if (isinstance(call, ast.Attribute) and call.attr in OPENERS)
        or (isinstance(call, ast.Name) and call.id in OPENERS - through_the_door)
    }
    return {call for call in found if SHIPPED not in call}


def test_files_of_users_are_read_through_one_door() -> None:
    found = {path.relative_to(PACKAGE).as_posix(): openings(parsed(path)) for path in modules()}
    assert {path: calls for path, calls in found.items() if calls} == {
        path: set(reasons) for path, reasons in READ_ELSEWHERE.items()
    }
    assert all(reason for reasons in READ_ELSEWHERE.values() for reason in reasons.values())


@pytest.mark.parametrize(
    "text",
    ["Path(name).read_text()", "open(name)", "path.open()", "io.open(name)", "np.loadtxt(name)", "os.open(name, 0)"],
)
def test_the_rule_of_the_door_catches_a_way_round_it(text: str) -> None:
    assert openings(ast.parse(text))


def test_the_rule_of_the_door_lets_the_door_and_our_own_data_pass() -> None:
    assert not openings(ast.parse("read_bytes(path, KIND)\n(files('radwrap') / 'data').read_text()"))


def test_nobody_else_makes_generators() -> None:
    makers = {
        path.relative_to(PACKAGE).as_posix()
        for path in modules()
        for node in nodes(path)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in {"default_rng", "RandomState", "PCG64"}
    }
    assert makers == {"random_streams.py"}


def test_no_module_is_too_long() -> None:
    lengths = {path.relative_to(PACKAGE).as_posix(): len(path.read_text("utf-8").splitlines()) for path in modules()}
    assert not {path: length for path, length in lengths.items() if length > LONGEST_MODULE}


def printed_by(code: str) -> str:
    """What a new interpreter prints that runs some code."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_has_no_side_effects() -> None:
    """The environment stays as it is, and libraries stay out of the command's first moment."""
    code = (
        "import os, sys; before = dict(os.environ); import radwrap.cli.main; assert dict(os.environ) == before;"
        "print([m for m in ('numpy', 'pydantic', 'scipy', 'cv2', 'matplotlib', 'trimesh') if m in sys.modules])"
    )
    assert printed_by(code) == "[]"


def test_a_command_that_begins_waits_for_no_library_that_it_may_not_need() -> None:
    """Each of them takes as long to load as all of radwrap, in every process of a study.

    Waves pass every image, if only to say what they would change: they take NumPy and nothing else.
    """
    code = (
        "import sys, numpy, radwrap.cli.render, radwrap.cli.explain, radwrap.cli.measure, radwrap.cli.study;"
        "from radwrap.imaging.optics.waves import Waves; from radwrap.scene.camera import Aperture;"
        "Waves(Aperture(), 0.01, 5e-7).transfer(0.0, numpy.zeros(2), numpy.zeros(2));"
        "print([m for m in ('scipy', 'cv2', 'matplotlib', 'trimesh', 'numba', 'OpenImageIO') if m in sys.modules])"
    )
    assert printed_by(code) == "[]"


def test_the_page_is_asked_for_before_what_makes_its_pictures_is_loaded() -> None:
    """The server tells the renderer what to trace first, and loads the rest while that works."""
    code = (
        "import sys, radwrap.cli.face, radwrap.face.serve, radwrap.face.recipe;"
        "print([m for m in ('synthesis', 'relight.relit', 'page.one_file') if f'radwrap.imaging.{m}' in sys.modules])"
    )
    assert printed_by(code) == "[]"


def test_a_small_image_with_diffraction_waits_for_scipy_no_more_than_one_without(tmp_path: Path) -> None:
    """It takes a sixth of such a render to load."""
    scene = PACKAGE.parent / "rad_scenes" / "bench_board" / "scene.toml"
    argv = ["render", str(scene), "--scale", "1/8", "--tolerance", "8", "--out", str(tmp_path / "out")]
    argv += ["--set", "camera.diffraction=on", "--tracer", "radiance"]
    code = f"import sys; from radwrap.cli.main import main; assert main({argv}) == 0; assert 'scipy' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
