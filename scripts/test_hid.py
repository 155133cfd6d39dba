"""The LED conformance cases on real HID devices of a Linux kernel, in virtual machines (`make test-hid`).

Two machines, both in software emulation of the processor: Debian's cloud kernel with uhid, and the full kernel with a
USB bus by vhci_hcd. Each boots an archive in memory that holds busybox, this Python, hidapi and the package, runs
tests/led/machine/inside.py, and is gone. Needs qemu-system-x86_64, busybox (static) and cpio; kernels come from the
Debian mirror that apt uses, and are kept in out/hid.
"""

from __future__ import annotations

import argparse
import gzip
import lzma
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from importlib.metadata import distribution
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent
STORE: Final = ROOT / "out" / "hid"
PACKAGES: Final = ("qemu-system-x86", "busybox-static", "cpio")
PROGRAMS: Final = ("qemu-system-x86_64", "busybox", "cpio", "apt-get", "dpkg-deb")
MACHINES: Final = {
    "uhid": ("linux-image-cloud-amd64", ("hid", "hid-generic", "uhid")),
    "vhci": (
        "linux-image-amd64",
        ("hid", "hid-generic", "uhid", "usb-common", "usbcore", "usbhid", "usbip-core", "vhci-hcd"),
    ),
}
TIME_LIMIT: Final = 600.0  # s
MEMORY: Final = 768  # MiB
# Parts of the standard library that no case needs.
_LEFT_OUT: Final = (
    "test",
    "idlelib",
    "tkinter",
    "ensurepip",
    "lib2to3",
    "site-packages",
    "dist-packages",
    "turtledemo",
)
_INIT: Final = """#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /tmp /root
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sys /sys
/bin/busybox mount -t devtmpfs dev /dev
/bin/busybox mount -t tmpfs tmp /tmp
/bin/busybox ip link set lo up
echo "BOOTED $(/bin/busybox cut -d' ' -f1 /proc/uptime) s"
for module in {modules}; do /bin/busybox insmod /modules/$module.ko || echo "no module $module"; done
export PYTHONPATH=/package PYTHONDONTWRITEBYTECODE=1 HOME=/root PATH=/bin PYTHONUNBUFFERED=1
{python} /package/tests/led/machine/inside.py {bus}
echo "ENDED $(/bin/busybox cut -d' ' -f1 /proc/uptime) s"
/bin/busybox poweroff -f
"""


def run(*argv: str | Path, folder: Path | None = None, stdin: bytes | None = None) -> bytes:
    """A program to its end; its output."""
    done = subprocess.run([str(word) for word in argv], cwd=folder, input=stdin, capture_output=True, check=False)
    if done.returncode:
        raise SystemExit(f"{argv[0]} failed: {done.stderr.decode(errors='replace').strip()[-500:]}")
    return done.stdout


def provide_programs() -> None:
    """Install what is missing, where apt is there; else say what."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if not missing:
        return
    if shutil.which("apt-get") is None:
        raise SystemExit(f"skipped: {', '.join(missing)} not found, and no apt-get to install them")
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    print(f"installing {' '.join(PACKAGES)} ...")
    run(*sudo, "apt-get", "update", "-qq")
    run(*sudo, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "install", "-y", "-qq",
        "--no-install-recommends", *PACKAGES)  # fmt: skip


def kernel(package: str) -> Path:
    """Folder of an unpacked kernel of Debian."""
    listed = run("apt-cache", "depends", package).decode()
    found = re.search(r"Depends: (linux-image-\S+)", listed)
    if found is None:
        raise SystemExit(f"skipped: apt knows no {package}; it needs the lists of a Debian mirror (apt-get update)")
    folder = STORE / found[1]
    if not folder.exists():
        print(f"fetching {found[1]} ...", flush=True)
        fetched = STORE / "debs"
        fetched.mkdir(parents=True, exist_ok=True)
        run("apt-get", "download", found[1], folder=fetched)
        (deb,) = fetched.glob(f"{found[1]}_*.deb")
        unpacked = STORE / f".{found[1]}"
        shutil.rmtree(unpacked, ignore_errors=True)
        run("dpkg-deb", "-x", deb, unpacked)
        unpacked.rename(folder)
        deb.unlink()
    return folder


def libraries(*objects: Path) -> set[Path]:
    """Shared libraries that objects need, with the loader."""
    found = set()
    for each in objects:
        told = subprocess.run(["ldd", str(each)], capture_output=True, text=True, check=False).stdout  # noqa: S607
        found |= {Path(path) for path in re.findall(r"(/\S+) \(0x", told)}
    return found


def put(source: Path, archive: Path, place: Path) -> None:
    """Copy a file into the archive's folder."""
    target = archive / place.relative_to("/")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    target.chmod(0o755)


def put_python(archive: Path) -> Path:
    """Copy this interpreter and its standard library to the same paths."""
    python = Path(sys.executable).resolve()
    library = Path(sysconfig.get_path("stdlib"))
    put(python, archive, python)
    shutil.copytree(library, archive / library.relative_to("/"), ignore=shutil.ignore_patterns(*_LEFT_OUT))
    extensions = list((library / "lib-dynload").glob("*.so"))
    for each in libraries(python, *extensions):
        put(each.resolve(), archive, each)
    return python


def put_package(archive: Path) -> None:
    """The package, the cases, hidapi, EasyMCP2221, and the tables by which libusb reads strings."""
    package = archive / "package"
    ignore = shutil.ignore_patterns("__pycache__", "*.cal", "init")
    for name in ("radwrap", "tests/led"):
        shutil.copytree(ROOT / name, package / name, ignore=ignore)
    for name in ("hidapi", "EasyMCP2221"):
        for each in distribution(name).files or ():
            source = Path(str(each.locate()))
            if source.is_file() and ".." not in each.parts and source.suffix != ".pyc":
                put(source, archive, Path("/package", each))
                if ".so" in source.name:
                    for needed in libraries(source):
                        if "hidapi" not in str(needed):  # those lie beside it
                            put(needed.resolve(), archive, needed)
    for folder in Path("/usr/lib").glob("*/gconv"):
        for name in ("UTF-16.so", "gconv-modules", "gconv-modules.cache"):
            if (folder / name).exists():
                put(folder / name, archive, folder / name)


def build(bus: str) -> tuple[Path, Path]:
    """Kernel and archive of a machine."""
    package, modules = MACHINES[bus]
    folder = kernel(package)
    archive = STORE / f"{bus}.root"
    shutil.rmtree(archive, ignore_errors=True)
    put(Path(shutil.which("busybox") or ""), archive, Path("/bin/busybox"))
    for each in libraries(Path(shutil.which("busybox") or "")):
        put(each.resolve(), archive, each)
    python = put_python(archive)
    put_package(archive)
    (archive / "modules").mkdir()
    for name in modules:
        (source,) = folder.glob(f"**/kernel/**/{name}.ko*")
        content = source.read_bytes()
        (archive / "modules" / f"{name}.ko").write_bytes(
            lzma.decompress(content) if source.suffix == ".xz" else content
        )
    init = archive / "init"
    init.write_text(_INIT.format(modules=" ".join(modules), python=python, bus=bus))
    init.chmod(0o755)
    names = b"\0".join(str(path.relative_to(archive)).encode() for path in sorted(archive.rglob("*")))
    packed = run("cpio", "-o", "-H", "newc", "--quiet", "-0", "-R", "0:0", folder=archive, stdin=names)
    image = STORE / f"{bus}.cpio.gz"
    image.write_bytes(gzip.compress(packed, 1))
    shutil.rmtree(archive)
    (linux,) = folder.glob("boot/vmlinuz-*")
    return linux, image


def boot(bus: str, linux: Path, image: Path) -> bool:
    """Run a machine to its end; whether all cases passed."""
    argv = ["qemu-system-x86_64", "-accel", "tcg", "-cpu", "max", "-m", str(MEMORY), "-nographic", "-no-reboot"]
    # On a busy host the kernel's check of the timer, which counts its ticks, would find none and panic.
    options = "console=ttyS0 quiet panic=-1 no_timer_check"
    argv += ["-nic", "none", "-kernel", str(linux), "-initrd", str(image), "-append", options]
    begin = time.monotonic()
    log = STORE / f"{bus}.log"
    with log.open("wb") as stream:
        machine = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT)
        try:
            machine.wait(TIME_LIMIT)
        except subprocess.TimeoutExpired:
            print(f"{bus}: no end within {TIME_LIMIT:g} s")
        finally:
            machine.kill()
            machine.wait()
    text = log.read_text(errors="replace").replace("\r", "")
    interesting = re.compile(r"^\s*(CASE|VERDICT|BOOTED|ENDED|off )")
    told = [line for line in text.splitlines() if interesting.match(line)]
    print("\n".join(told))
    passed = [line for line in told if line.startswith("CASE ok")]
    verdict = re.search(rf"VERDICT {bus}: 0 failures", text) is not None and len(passed) > 0
    print(
        f"{bus}: {len(passed)} cases passed, {'all' if verdict else 'NOT ALL'}; {time.monotonic() - begin:.1f} s; {log}"
    )
    return verdict


def main() -> int:
    """Both machines, or the ones that are named."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machine", choices=list(MACHINES), help="only this one")
    chosen = parser.parse_args().machine
    wanted = [chosen] if chosen else list(MACHINES)
    provide_programs()
    STORE.mkdir(parents=True, exist_ok=True)
    return 0 if all([boot(bus, *build(bus)) for bus in wanted]) else 1


if __name__ == "__main__":
    sys.exit(main())
