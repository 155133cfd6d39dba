"""The layout is a promise: data flows one way, and each foreign package has one door."""

import ast
import subprocess
import sys
from pathlib import Path

import radwrap

PACKAGE = Path(radwrap.__file__).parent

# Each folder may import itself, the ground, and what stands before it.
ORDER = ["ground", "scene", "tracers", "imaging", "convert", "measure", "calibrate", "study", "led", "validate", "cli"]

DOORS = {
    "subprocess": {"process.py"},
    "OpenImageIO": {"images.py"},
    "cv2": {
        "measure/dots/detect.py",
        "measure/dots/overlay.py",
        "calibrate/opencv_solver.py",
        "measure/compare.py",
        "measure/parts/overlay.py",
        "measure/parts/raster.py",
        "scene/file/calibration_file.py",
    },
    "pydantic": {
        "scene/file/border.py",
        "scene/file/document.py",
        "scene/file/load.py",
        "scene/file/material_tables.py",
        "scene/file/optics_tables.py",
        "scene/file/sensor_tables.py",
        "scene/file/source_tables.py",
        "imaging/run_files.py",  # what a run leaves as JSON
        "written.py",  # reads it back
    },
    "tomllib": {
        "reading.py",
        "scene/file/border.py",
        "scene/file/sensor_tables.py",
    },  # the latter two read our own tables
    "pydantic_core": {"scene/file/load.py"},
    "trimesh": {"scene/mesh_files/parts.py", "convert/preview_files.py"},
    "cascadio": set(),
    "pyradiance": set(),
    "hid": {"led/ports.py"},
    "hidraw": {"led/ports.py"},
    "EasyMCP2221": set(),
    "ctypes": set(),
    "multiprocessing": {"study/pool.py"},
    "distributed": {"study/pool.py"},
    "jinja2": {"study/report.py", "validate/report.py"},
    "pyDOE3": {"study/runs.py"},
    "statsmodels": {"study/variance.py"},
    "pandas": {"study/variance.py"},
}
LONGEST_MODULE = 500  # lines; a longer one becomes a folder


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def room(name: str) -> str:
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in ORDER else "ground"


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_data_flows_one_way() -> None:
    wrong = []
    for path in modules():
        inside = path.relative_to(PACKAGE)
        if inside == Path("__init__.py"):
            continue  # the few public names
        here = inside.parts[0] if len(inside.parts) > 1 else "ground"
        for name in imports(path):
            if name.startswith("radwrap.") and ORDER.index(room(name)) > ORDER.index(here):
                wrong.append(f"{inside} imports {name}")
    assert not wrong


def test_the_rule_catches_an_import_against_the_stream(tmp_path: Path) -> None:
    offender = tmp_path / "camera.py"
    offender.write_text("from radwrap.imaging.response.sensor import gray_levels\n")
    (name,) = imports(offender)
    assert ORDER.index(room(name)) > ORDER.index("scene")


def test_every_folder_has_its_place_in_the_order() -> None:
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(ORDER)


def test_each_foreign_package_has_one_door() -> None:
    wrong = []
    for path in modules():
        inside = path.relative_to(PACKAGE).as_posix()
        for name in imports(path):
            package = name.split(".")[0]
            if package in DOORS and inside not in DOORS[package]:
                wrong.append(f"{inside} imports {package}")
    assert not wrong


def test_no_module_is_too_long() -> None:
    lengths = {path.name: len(path.read_text("utf-8").splitlines()) for path in modules()}
    assert max(lengths.values()) <= LONGEST_MODULE, lengths


def test_importing_has_no_side_effects() -> None:
    """The environment stays as it is, and libraries stay out of the command's first moment."""
    code = (
        "import os, sys; before = dict(os.environ); import radwrap.cli.main; assert dict(os.environ) == before;"
        "print([m for m in ('numpy', 'pydantic', 'scipy', 'cv2', 'matplotlib', 'trimesh') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
