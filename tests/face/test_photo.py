"""A photo on the page: what may do harm is refused within limits, what is a photo is compared with what is expected."""

from __future__ import annotations

import asyncio
import json
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import cv2
import numpy as np
import pytest

from radwrap.errors import EnvironmentFailure, InputError
from radwrap.face import decoder, photo
from radwrap.face.decoder import LARGEST, kind_of
from radwrap.face.gate import LARGEST_BODY, OCTETS, Door, Gate
from radwrap.face.photo import Photo, as_the_camera_has_it, compared, decoded
from radwrap.face.traced import Image
from radwrap.images import ExposureImage, write_exr
from radwrap.process import Limits
from radwrap.scene.camera import Sensor
from tests.face.conftest import Answer, Served

ROWS, COLUMNS = 20, 24
GRAYS: Final = np.arange(ROWS * COLUMNS, dtype=np.uint16).reshape(ROWS, COLUMNS) % 200


def encoded(suffix: str, pixels: np.ndarray) -> bytes:
    done, octets = cv2.imencode(suffix, pixels)
    assert done
    return octets.tobytes()


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(columns: int, rows: int, packed: bytes, *more: bytes) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(more) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def exr(tmp_path: Path, pixels: np.ndarray) -> bytes:
    write_exr(tmp_path / "photo.exr", pixels.astype(np.float32), channel="Y")
    return (tmp_path / "photo.exr").read_bytes()


def here(content: bytes, tmp_path: Path) -> tuple[Mapping[str, Any], np.ndarray]:
    """Decoded without a process of its own, to be quick."""
    with tempfile.TemporaryFile() as file:
        file.write(content)
        file.flush()
        told, octets = decoder._decoded(file.fileno(), COLUMNS, ROWS, tmp_path)
    assert not list(tmp_path.glob("photo_*")), "its name is left"
    return told, np.frombuffer(octets, "<f4").reshape(ROWS, COLUMNS)


# ------------------------------------------------------------------------------------------------------------- Decoding


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_gray_levels_are_as_stored(tmp_path: Path, suffix: str, kind: Any) -> None:
    pixels = (GRAYS * (1 if kind is np.uint8 else 257)).astype(kind)
    told, found = here(encoded(suffix, pixels), tmp_path)
    assert np.array_equal(found, pixels)
    assert (told["bit_depth"], told["whole"]) == (8 * pixels.itemsize, True)


def test_floats_are_gray_levels_and_jpeg_is_nearly_what_it_was(tmp_path: Path) -> None:
    told, found = here(exr(tmp_path, GRAYS + 0.25), tmp_path)
    assert np.array_equal(found, GRAYS + np.float32(0.25)) and not told["whole"]
    told, found = here(encoded(".jpg", np.full((ROWS, COLUMNS), 77, np.uint8)), tmp_path)
    assert abs(found - 77).max() <= 1 and told["kind"] == "jpg"


def bombs(tmp_path: Path) -> dict[str, tuple[bytes, str]]:
    good = encoded(".png", GRAYS.astype(np.uint8))
    colour = np.stack([GRAYS, GRAYS[::-1], GRAYS], axis=2).astype(np.uint8)
    nan = np.where(GRAYS == 7, np.nan, GRAYS).astype(np.float32)
    return {
        "truncated PNG": (good[: len(good) // 2], "is not complete"),
        "truncated TIFF": (encoded(".tif", GRAYS)[:200], "is not"),
        "truncated JPEG": (encoded(".jpg", GRAYS.astype(np.uint8))[:300], "is not complete"),
        "truncated PGM": (encoded(".pgm", GRAYS)[:100], "is not complete"),
        "truncated EXR": (exr(tmp_path, GRAYS)[:400], "is not"),
        "a header of 10^10 pixels": (png(100_000, 100_000, zlib.compress(bytes(1000))), "malicious header"),
        "10^8 pixels that are packed well": (
            png(10_000, 10_000, zlib.compress(bytes(10_001 * 10_000))),
            "the limit is",
        ),
        "a PGM of 10^10 pixels": (b"P5 100000 100000 255\n" + bytes(1000), "may not exceed"),
        "another size": (encoded(".png", GRAYS[:, :-1].astype(np.uint8)), "has 23 x 20 pixels, the picture 24 x 20"),
        "turned by 90 degrees": (encoded(".png", GRAYS.T.astype(np.uint8)), "has 20 x 24 pixels"),
        "colour": (encoded(".png", colour), "is in colour"),
        "a colour PPM": (encoded(".ppm", colour), "is in colour"),
        "NaN": (encoded(".tif", nan), "holds NaN or infinity"),
        "nothing": (b"", "is none of PNG"),
        "a page": (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "is none of PNG"),
        "a GIF": (b"GIF89a" + bytes(100), "is none of PNG"),
        "a bitmap": (encoded(".bmp", GRAYS.astype(np.uint8)), "is none of PNG"),
        "its beginning only": (b"\x89PNG\r\n\x1a\n", "is not complete"),
    }


def test_what_is_no_such_photo_is_one_clear_error(tmp_path: Path) -> None:
    for name, (content, says) in bombs(tmp_path).items():
        with pytest.raises(InputError) as refused:
            here(content, tmp_path)
        assert says in refused.value.what, (name, refused.value)


def test_what_a_photo_holds_beyond_its_pixels_is_not_unpacked(tmp_path: Path) -> None:
    """64 MiB of zeros in the pixels' place, and in a comment, in a small file."""
    zeros = zlib.compress(bytes(1 << 26), 9)
    for content in (
        png(COLUMNS, ROWS, zeros),
        png(COLUMNS, ROWS, zlib.compress(bytes(ROWS * (COLUMNS + 1))), chunk(b"zTXt", b"Comment\0\0" + zeros)),
    ):
        _, found = here(content, tmp_path)
        assert not found.any()


def test_an_image_beside_the_known_kinds_is_not_even_tried(tmp_path: Path) -> None:
    """Each library that reads pictures has its holes: only five are asked, and no process begins for others."""
    for content in (
        b"GIF89a",
        b"BM",
        b"8BPS",
        b"\0\0\1\0",
        b"RIFF",
        b"%PDF",
        b"#?RADIANCE\n",
        b"P1 ",
        b"P7 ",
        b"\x89PNF",
    ):
        assert kind_of(content + bytes(20)) is None
        with pytest.raises(InputError, match="is none of"):
            decoded(content + bytes(20), ROWS, COLUMNS, tmp_path)


def test_a_process_of_its_own_decodes_with_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = encoded(".png", GRAYS.astype(np.uint8))
    told, found = decoded(content, ROWS, COLUMNS, tmp_path)
    assert np.array_equal(found, GRAYS) and told["kind"] == "png"
    for limits in (Limits(total=0.01), Limits(total=0.05), Limits(memory=32 << 20)):  # no picture is so small
        monkeypatch.setattr(photo, "LIMITS", limits)
        with pytest.raises(InputError, match="cannot be decoded within"):
            decoded(content, ROWS, COLUMNS, tmp_path)
    assert not list(tmp_path.iterdir())


PROBE: Final = """
import resource, sys
from pathlib import Path
from radwrap.errors import InputError
from radwrap.face import decoder
def probe(held, columns, rows, folder):
    said = []
    for name in ("photo.png", "/dev/shm/photo_that_is_written"):
        try:
            (folder / name).write_bytes(b"x")
        except OSError as error:
            said.append(error.errno)
    said += [resource.getrlimit(what)[1] for what in (resource.RLIMIT_CPU, resource.RLIMIT_AS, resource.RLIMIT_CORE)]
    raise InputError(repr(said))
decoder._decoded = probe
sys.exit(decoder.main(sys.argv[1:]))
"""


def test_the_decoder_can_write_no_file_and_limits_itself(tmp_path: Path) -> None:
    argv = [sys.executable, "-c", PROBE, "1", "1", str(tmp_path)]
    done = subprocess.run(argv, input=b"x", capture_output=True, timeout=60, check=True)
    told = json.loads(done.stdout)["error"]
    assert told == repr([27, 27, 10, 2 << 30, 0])  # 27: EFBIG


@pytest.mark.long
def test_the_largest_photo_that_is_allowed_is_decoded(tmp_path: Path) -> None:
    """8192 x 8192 pixels of 16 bits, within time and memory."""
    pixels = np.tile(np.arange(8192, dtype=np.uint16), (8192, 1))
    for suffix in (".png", ".tif", ".pgm"):
        _, found = decoded(encoded(suffix, pixels), 8192, 8192, tmp_path)
        assert found[5000, 77] == 77 and found.sum(dtype=np.float64) == 8192.0 * 8191 * 4096


def test_where_memory_cannot_be_limited_no_photo_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(photo.os, "memfd_create")
    with pytest.raises(EnvironmentFailure, match="Linux only"):
        decoded(encoded(".png", GRAYS.astype(np.uint8)), ROWS, COLUMNS, tmp_path)


def test_larger_photos_are_refused_before_they_are_read(tmp_path: Path) -> None:
    content = bytearray(LARGEST + 1)
    content[:8] = b"\x89PNG\r\n\x1a\n"
    with pytest.raises(InputError, match="more than 256 MiB"):
        decoded(memoryview(content), ROWS, COLUMNS, tmp_path)


# -------------------------------------------------------------------------------------------------------- What is right


@pytest.mark.parametrize(
    ("most", "file", "camera", "says"),
    [
        (255, 8, 8, None),
        (4095, 16, 12, None),
        (65535, 16, 16, None),
        (1023, 12, 10, None),
        (255, 8, 12, "holds 8 bits, the camera gives 12"),
        (4095, 16, 8, "ends? at 255"),
        (65535, 16, 12, "ends? at 4095"),
        (15, 8, 4, "holds 8 bits"),
    ],
)
def test_bits_are_those_of_the_camera(most: int, file: int, camera: int, says: str | None) -> None:
    values = np.linspace(0, most, 480).round().astype(np.float32).reshape(ROWS, COLUMNS)
    if says is None:
        assert as_the_camera_has_it(values, file, camera, whole=True) == ()
        return
    with pytest.raises(InputError, match=says):
        as_the_camera_has_it(values, file, camera, whole=True)


def test_gray_levels_at_the_upper_end_of_a_file_are_refused() -> None:
    """A dim picture of 12 bits, shifted by four: it would pass for one of lower gray levels."""
    shifted = (GRAYS % 16 * 16).astype(np.float32)
    with pytest.raises(InputError, match="multiples of 16 only"):
        as_the_camera_has_it(shifted, 16, 12, whole=True)
    assert as_the_camera_has_it(shifted + 1, 16, 12, whole=True) == ()
    assert as_the_camera_has_it(np.zeros((2, 2), np.float32), 16, 12, whole=True) == ()
    with pytest.raises(InputError, match="negative"):
        as_the_camera_has_it(np.full((2, 2), -1.0, np.float32), 16, 12, whole=False)


SENSOR: Final = Sensor(80, 96, 1e-5, 1e-5, gain=3.38e4, gamma=0.85, dark_gray=22, saturation_gray=181)


@pytest.fixture(scope="module")
def image() -> Image:
    """Spots on a ground, between dark and saturation; with a deviation of two gray levels."""
    v, u = np.mgrid[:80, :96]
    spots = sum(np.exp(-((u - x) ** 2 + (v - y) ** 2) / 40) for x in (20, 48, 76) for y in (18, 40, 62))
    exposure = ExposureImage(1e-4 + 1.2e-3 * spots)
    known = SimpleNamespace(radiant_exposure=exposure), SimpleNamespace(basis=SimpleNamespace(sensor=SENSOR))
    return Image(known[0], {}, np.full((80, 96), 2.0), known[1], {}, None)  # type: ignore[arg-type]


def gray_of(image: Image) -> np.ndarray:
    """Eq. 5 by hand."""
    sensor = image.relighter.basis.sensor
    gray = sensor.gain * image.relit.radiant_exposure.values**sensor.gamma + sensor.dark_gray
    return np.minimum(gray, sensor.saturation_gray)


def test_what_scatters_as_expected_is_found_as_expected(image: Image) -> None:
    """A photo drawn with the picture's own deviation: 5 % beyond, no mean, the expected rms; no cause is named."""
    gray, random = gray_of(image), np.random.default_rng(5)
    photo_of = Photo(1, (gray + 2.0 * random.standard_normal(gray.shape)).astype(np.float32), 8, ())
    found = compared(photo_of, image)
    share = np.sqrt(0.05 * 0.95 / gray.size)
    assert abs(found["beyond"] - 0.05) < 4 * share
    assert abs(found["mean"]) < 4 * 2.0 / np.sqrt(gray.size)
    assert found["expected_rms"] == pytest.approx(2.0) and found["rms"] == pytest.approx(
        2.0, rel=4 / np.sqrt(2 * gray.size)
    )
    assert found["causes"] is None


def test_scatter_alone_has_no_cause() -> None:
    """A regular pattern lies on itself when it is moved by its period, and interpolation smooths scatter."""
    sensor = replace(SENSOR, rows=200, columns=240)
    v, u = np.mgrid[:200, :240]
    exposure = ExposureImage(1e-4 + 6e-4 * (1 + np.sin(u / 4.3) * np.sin(v / 5.3)))
    known = SimpleNamespace(radiant_exposure=exposure), SimpleNamespace(basis=SimpleNamespace(sensor=sensor))
    regular = Image(known[0], {}, np.full((200, 240), 2.0), known[1], {}, None)  # type: ignore[arg-type]
    scatter = 2.0 * np.random.default_rng(3).standard_normal((200, 240))
    found = compared(Photo(1, (gray_of(regular) + scatter).astype(np.float32), 8, ()), regular)
    assert found["causes"] is None and found["rms"] < 1.05 * found["expected_rms"]


@pytest.mark.parametrize(
    ("spoil", "mean", "cause"),
    [
        (lambda gray: gray + 3, lambda _: 3.0, "dark level"),
        (lambda gray: 22 + 1.1 * (gray - 22), lambda gray: 0.1 * float(np.mean(gray - 22)), "exposure"),
        (lambda gray: np.roll(gray, 2, axis=1), lambda _: 0.0, "geometry"),
    ],
)
def test_a_photo_says_what_is_wrong(
    image: Image, spoil: Callable[..., Any], mean: Callable[..., float], cause: str
) -> None:
    """The sign is that of photo - picture."""
    gray = gray_of(image)
    found = compared(Photo(1, spoil(gray).astype(np.float32), 8, ()), image)
    assert found["causes"]["mainly"] == cause
    assert found["mean"] == pytest.approx(mean(gray), abs=1e-4)
    off = spoil(gray) - gray
    assert found["rms"] == pytest.approx(float(np.sqrt(np.mean(off**2))), rel=1e-5)
    worst = found["worst"]
    assert abs(worst["photo"] - worst["picture"]) == pytest.approx(np.abs(off).max(), rel=1e-4)
    if cause == "geometry":
        assert found["causes"]["shift"] == pytest.approx((2.0, 0.0), abs=0.1)


def test_a_photo_of_another_camera_is_refused(image: Image) -> None:
    with pytest.raises(InputError, match="of 10 bits, the picture"):
        compared(Photo(1, gray_of(image).astype(np.float32), 10, ()), image)
    with pytest.raises(InputError, match="has 95 x 80 pixels"):
        compared(Photo(1, gray_of(image)[:, 1:].astype(np.float32), 8, ()), image)


# ----------------------------------------------------------------------------------------------------------- The server


def sent(served: Served, content: bytes, told: Mapping[str, Any], **headers: str) -> Answer:
    given = {"Authorization": f"Bearer {served.token}", "Content_Type": OCTETS.decode(), **headers}
    return served.ask("POST", "/api/photo", json.dumps(told).encode() + b"\n" + content, **given)


def test_a_photo_is_taken_compared_and_written_nowhere(served: Served) -> None:
    basis = served.ready()["basis"]
    told = {"basis": basis, "turn": {"levels": [1.0, 0.5]}}
    gray = served.post("/api/png", told)
    codes = cv2.imdecode(np.frombuffer(gray.body, np.uint8), cv2.IMREAD_UNCHANGED)
    before = sorted(path for folder in (served.out, served.link.parent) for path in folder.rglob("*"))
    answer = sent(served, gray.body, told)
    assert answer.status == 200, answer.body
    head, (values,) = answer.blocks()
    assert np.array_equal(values.reshape(codes.shape), codes) and head["bit_depth"] == 8
    found = served.post("/api/compare", {**told, "photo": head["photo"]}).json
    assert 0 < found["rms"] < 0.5 and abs(found["mean"]) < 0.1  # rounding alone
    assert found["beyond"] == 0.0
    darker = served.post("/api/compare", {"basis": basis, "turn": {"levels": [1.0, 0.0]}, "photo": head["photo"]}).json
    assert darker["mean"] > 1 and darker["beyond"] > 0.5
    # What is wrong is one error, and the photo before is still there.
    for content, says in ((gray.body[:-30], "is not complete"), (b"MZ" + bytes(99), "is none of"), (b"", "is none of")):
        refused = sent(served, content, told)
        assert refused.status == 422 and says in refused.json["error"] and refused.json["where"] == "photo"
    assert served.post("/api/compare", {**told, "photo": head["photo"]}).json == found
    assert served.post("/api/compare", {**told, "photo": 99}).status == 422
    assert served.post("/api/compare", {**told, "photo": "1"}).status == 422
    assert sorted(path for folder in (served.out, served.link.parent) for path in folder.rglob("*")) == before


def test_a_photo_comes_by_its_own_door_only(served: Served) -> None:
    basis = {"basis": served.ready()["basis"]}
    assert sent(served, b"", basis, Content_Type="application/json").status == 403
    assert sent(served, b"", basis, Content_Type="image/png").status == 403
    assert sent(served, b"", basis, Authorization="Bearer x").status == 401
    own = {"Authorization": f"Bearer {served.token}", "Content_Type": OCTETS.decode()}
    assert served.ask("POST", "/api/turn", json.dumps(basis).encode(), **own).status == 403
    for body in (b"", b"\n", b"[" * 100_000, b"{}", b'{"basis": 1e9}\n', b"x" * (LARGEST_BODY + 9)):
        answer = served.ask("POST", "/api/photo", body, **own)
        assert answer.status == 422 and answer.json["error"], body[:20]


def gate_of(entered: list[int], hold: asyncio.Event | None = None) -> Gate:
    async def app(_: Any, receive: Any, send: Any) -> None:
        entered.append(len((await receive())["body"]))
        if hold is not None:
            await hold.wait()
        await send({"type": "http.response.start", "status": 200})

    table = {"/photo": Door("POST", True, OCTETS, LARGEST_BODY + 10), "/turn": Door("POST", True)}
    return Gate(app, table, port=1, token="t")  # noqa: S106


def asked(
    gate: Gate, path: str, parts: list[int], token: bytes = b"t", announced: int = 0
) -> tuple[Any, list[Any], list[int]]:
    """A request of some parts; what is said to it, and which parts were taken."""
    said: list[Any] = []
    taken: list[int] = []
    content = OCTETS if path == "/photo" else b"application/json"
    headers = [(b"host", b"localhost:1"), (b"authorization", b"Bearer " + token), (b"content-type", content)]
    headers += [(b"content-length", str(announced).encode())] if announced else []
    scope = {"type": "http", "method": "POST", "path": path, "raw_path": path.encode(), "headers": headers}

    async def receive() -> Any:
        taken.append(parts[len(taken)])
        return {"type": "http.request", "body": bytes(taken[-1]), "more_body": len(taken) < len(parts)}

    async def send(message: Any) -> None:
        said.append(message)

    return gate(scope, receive, send), said, taken


@pytest.mark.parametrize(
    ("path", "parts", "token", "status", "read"),
    [
        ("/photo", [LARGEST_BODY, 10], b"t", 200, 2),
        ("/photo", [LARGEST_BODY, 10, 1, 1, 1], b"t", 413, 3),
        ("/turn", [LARGEST_BODY, 1, 1, 1], b"t", 413, 2),
        ("/photo", [LARGEST_BODY, 1, 1, 1], b"x", 401, 2),  # who lacks the token is not heard out
    ],
)
def test_only_whom_the_server_knows_may_send_much(
    path: str, parts: list[int], token: bytes, status: int, read: int
) -> None:
    entered: list[int] = []
    done, said, taken = asked(gate_of(entered), path, parts, token)
    asyncio.run(done)
    assert said[0]["status"] == status and len(taken) == read
    assert bool(entered) is (status == 200)


def test_what_announces_too_much_is_not_let_in() -> None:
    for announced, status in ((LARGEST_BODY + 10, 200), (LARGEST_BODY + 11, 413)):
        done, said, _ = asked(gate_of([]), "/photo", [1], announced=announced)
        asyncio.run(done)
        assert said[0]["status"] == status


def test_one_large_body_is_held_at_a_time() -> None:
    async def two() -> None:
        entered: list[int] = []
        hold = asyncio.Event()
        gate = gate_of(entered, hold)
        requests = [asked(gate, path, [5]) for path in ("/photo", "/photo", "/turn")]
        tasks = [asyncio.create_task(done) for done, *_ in requests]
        await asyncio.sleep(0.01)
        assert [len(taken) for _, _, taken in requests] == [1, 0, 1]  # the second is not read yet; others go on
        hold.set()
        await asyncio.gather(*tasks)
        assert [said[0]["status"] for _, said, _ in requests] == [200] * 3

    asyncio.run(two())
