"""What the LED ring promises, measured on emulators: SIGKILL, a played study, and the twin that calibrates itself.

Prints a table and writes it with all numbers as JSON. Nothing here touches a real device.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import radwrap
from radwrap.images import read_image
from radwrap.imaging.response.sensor import gray_levels
from radwrap.led.connect import EmulatorProcess
from radwrap.led.emulated_port import EmulatedPort
from radwrap.led.from_scene import leds_of
from radwrap.manifest import json_text

ROOT: Final = Path(__file__).parent.parent
SCENE: Final = ROOT / "rad_scenes" / "bench_board" / "scene.toml"
COMMAND: Final = Path(sys.executable).with_name("radwrap")
FULL: Final = "60 mW/sr"
STEPS: Final = 4096
SPREAD: Final = 0.15
PATIENCE: Final = 60.0
DRIVE: Final = """count = 12
wavelength = "850 nm"
rated_current = "100 mA"
drive_current = "50 mA"
max_level = 1.0
max_sum = 12.0
max_on_time = "60 s"
"""


def radwrap_command(*argv: object) -> str:
    """The command to its end; its stdout."""
    done = subprocess.run([str(COMMAND), *map(str, argv)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"radwrap {argv[0]}: {done.stderr}")
    return done.stdout


def write_table(path: Path, rows: Sequence[Sequence[object]]) -> None:
    """A CSV file."""
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)


def kills(folder: Path, number: int) -> dict[str, Any]:
    """SIGKILL of the driver with all LEDs on: time until the emulated LEDs are dark, as the emulator saw it."""
    times = []
    with EmulatorProcess() as emulator:
        port = EmulatedPort(emulator.socket)
        for index in range(number):
            argv = [COMMAND, "led", "set", "0.5", "--emulator", emulator.socket, "--drive", folder / "drive.toml"]
            argv += ["--for", "50 s"]
            driver = subprocess.Popen(list(map(str, argv)), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            wait(lambda: all(port.history()[-1][1]))
            time.sleep(0.02 * (index % 20))  # at any moment between heartbeats
            driver.kill()
            killed = time.monotonic()
            wait(lambda: not any(port.history()[-1][1]))
            times.append(port.history()[-1][0] - killed)
            driver.wait()
            claim_falls(emulator.socket)
        port.close()
    return {"number": number, "within_2_s": sum(t < 2 for t in times), "median_s": float(np.median(times)),
            "longest_s": max(times)}  # fmt: skip


def claim_falls(socket: str) -> None:
    """Wait until the guardian of a killed driver has ended."""
    from radwrap.errors import EnvironmentFailure
    from radwrap.led.claim import Claim

    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            Claim(f"emulator:{socket}").release()
        except EnvironmentFailure:
            time.sleep(0.01)
        else:
            return
    raise SystemExit("a guardian does not end")


def wait(condition: Any) -> None:
    """Until something is so."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit("nothing happened")
        time.sleep(0.002)


def study(folder: Path, basis: Path) -> dict[str, Any]:
    """16 rows on the emulator: what it showed against the design, in PWM steps and in rendered gray levels."""
    scene = radwrap.load_scene(SCENE)
    names = [led.name for led in leds_of(scene)]
    step = float(FULL.split()[0]) * 1e-3 / leds_of(scene)[0].radiant_intensity / STEPS
    factors = np.random.default_rng(1).uniform(0, 1.2, (16, len(names)))
    rows = [[f"row{k:02d}", *(f"{value:.4f}" for value in row)] for k, row in enumerate(factors)]
    write_table(folder / "rows.csv", [["name", *names], *rows])
    out = folder / "play"
    radwrap_command("led", "play", SCENE, "--rows", folder / "rows.csv", "--out", out, "--emulate", "--full-scale",
                    FULL, "--drive", folder / "drive.toml", "--camera", sys.executable, "-c", "pass")  # fmt: skip
    for name, table in (("designed", folder / "rows.csv"), ("shown", out / "played.csv")):
        radwrap_command("relight", basis, "--levels", table, "--out", folder / name, "--exposure")
    shown = {row[0]: np.array(row[1:], dtype=float) for row in list(csv.reader((out / "played.csv").open()))[1:]}
    steps, gray, pixels = 0.0, 0.0, []
    for row in rows:
        steps = max(steps, float(np.abs(shown[str(row[0])] - np.array(row[1:], dtype=float)).max()) / step)
        exposures = [read_image(folder / kind / f"{row[0]}.exr")[0].astype(float) for kind in ("designed", "shown")]
        one, other = (gray_levels(exposure, scene.camera.sensor) for exposure in exposures)
        gray = max(gray, float(np.abs(one - other).max()))
        codes = [read_image(folder / kind / f"{row[0]}.png")[0].astype(int) for kind in ("designed", "shown")]
        pixels.append(float(np.mean(codes[0] != codes[1])))
    return {"rows": 16, "largest_difference_steps": steps, "largest_difference_gray": gray,
            "pixels_that_round_otherwise": max(pixels)}  # fmt: skip


def twin(folder: Path, basis: Path, rings: int) -> dict[str, Any]:
    """Rings with random factors, each seen in 13 rendered captures of 8 bit, against the nominal scene."""
    scene = radwrap.load_scene(SCENE)
    names = [led.name for led in leds_of(scene)]
    alone = [["name", *names], ["dark", *[0] * len(names)]]
    alone += [[f"led{n:02d}", *[int(n == m) for m in range(len(names))]] for n in range(len(names))]
    write_table(folder / "alone.csv", alone)
    leds = []
    for ring in range(rings):
        factors = np.random.default_rng(ring + 1).uniform(1 - SPREAD, 1 + SPREAD, len(names))
        tables = [{"index": n, "radiance_factor": float(value)} for n, value in enumerate(factors)]
        inline = "[" + ", ".join("{" + ", ".join(f"{k} = {v!r}" for k, v in t.items()) + "}" for t in tables) + "]"
        real, film, play = (folder / f"{kind}{ring}" for kind in ("real", "film", "captures"))
        radwrap_command("render", SCENE, "--set", f"sources[0].leds={inline}", "--basis", "--tolerance", "0.1",
                        "--seed", 100 + ring, "--out", real)  # fmt: skip
        radwrap_command("relight", real, "--levels", folder / "alone.csv", "--out", film)
        copy = "import shutil, sys; shutil.copy(sys.argv[1], '.')"
        radwrap_command("led", "play", SCENE, "--alone", "--out", play, "--emulate", "--full-scale", FULL, "--drive",
                        folder / "drive.toml", "--camera", sys.executable, "-c", copy, film / "{name}.png")  # fmt: skip
        told = json.loads(radwrap_command("led", "calibrate", "--captures", play, "--basis", basis, "--json",
                                          "--out", folder / f"ring{ring}.json"))  # fmt: skip
        leds += [
            {"ring": ring, "led": n, "true": float(true), "found": found["factor"],
             "standard_error": found["factor_standard_error"]}
            for n, (true, found) in enumerate(zip(factors, told["leds"], strict=True))
        ]  # fmt: skip
    errors = np.array([led["found"] - led["true"] for led in leds])
    stated = np.array([led["standard_error"] for led in leds])
    return {
        "leds": leds,
        "largest_error": float(np.abs(errors).max()),
        "rms_error": float(np.sqrt(np.mean(errors**2))),
        "mean_standard_error": float(stated.mean()),
        "rms_of_error_over_standard_error": float(np.sqrt(np.mean((errors / stated) ** 2))),
        "largest_of_error_over_standard_error": float(np.abs(errors / stated).max()),
    }


def main() -> int:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", default="out/led", help="folder of the results")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--rings", type=int, default=3)
    given = parser.parse_args()
    folder = Path(given.out).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "drive.toml").write_text(DRIVE)
    basis = folder / "basis"
    radwrap_command("render", SCENE, "--basis", "--tolerance", "0.1", "--out", basis)
    found = {
        "kills": kills(folder, given.kills),
        "study": study(folder, basis),
        "twin": twin(folder, basis, given.rings),
    }
    (folder / "led.json").write_text(json_text(found))
    for name, numbers in found.items():
        for key, value in numbers.items():
            if key != "leds":
                print(f"{name:6} {key:40} {value:.4g}")
    for led in found["twin"]["leds"]:
        error = led["found"] / led["true"] - 1
        told = f"{led['true']:.4f} found {led['found']:.4f}, {100 * error:+.3f} %"
        print(f"ring {led['ring']} LED {led['led']:2}: {told}, stated {100 * led['standard_error']:.3f} %")
    good = found["kills"]["within_2_s"] == given.kills and found["study"]["largest_difference_steps"] <= 1
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
