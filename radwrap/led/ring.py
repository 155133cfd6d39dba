"""The ring as one drives it: levels in, light out, and dark whenever something goes wrong."""

from __future__ import annotations

import atexit
import math
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Final

from radwrap.errors import EnvironmentFailure, InputError, RadwrapError
from radwrap.led.backend import Backend, Capabilities, Kind
from radwrap.led.calibration import levels_for
from radwrap.led.claim import Claim
from radwrap.led.connect import open_backend
from radwrap.led.drive import Drive
from radwrap.led.guardian import BEAT, MISSED, Guardian
from radwrap.led.ports import Found
from radwrap.scene.file.ring_calibration import RingCalibration

# Currents that are written with three digits are the same.
_SAME_CURRENT: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Frame:
    """What the ring shows.

    Attributes
    ----------
    levels : tuple of float
        As they were asked for, 0 to 1.
    steps : tuple of int
        As they were sent: whole steps of the device.
    held : tuple of float
        As the device says that it holds them; the sent ones where it says nothing.
    verified : bool
        Whether the device said so.
    emulated : bool
        Whether the device is software.
    """

    levels: tuple[float, ...]
    steps: tuple[int, ...]
    held: tuple[float, ...]
    verified: bool
    emulated: bool


class LedRing:
    """A ring of LEDs; use as ``with open_ring(...) as ring``.

    One thread drives it; a second one sends heartbeats to the guardian and
    ends light that lasts too long.

    Parameters
    ----------
    backend : Backend
        The electronics, with every LED off.
    drive : Drive or None
        What the LEDs may do; without it there is no light.
    calibration : RingCalibration or None
        Level to radiant intensity; without it radiant intensities cannot be set.
    guardian : Guardian or None
        Who turns off when this process cannot.
    """

    def __init__(
        self,
        backend: Backend,
        drive: Drive | None,
        calibration: RingCalibration | None = None,
        guardian: Guardian | None = None,
    ) -> None:
        self._backend = backend
        self._drive = drive
        self._calibration = calibration
        self._guardian = guardian
        if calibration is not None:
            _check_calibration(calibration, backend.capabilities, drive)
        self._lock = threading.RLock()
        self._lit_since: float | None = None
        self._busy_since: float | None = None
        self._trouble: RadwrapError | None = None
        self._closed = threading.Event()
        self._beats = threading.Thread(target=self._beat, daemon=True)
        self._beats.start()
        atexit.register(self.close)

    @property
    def capabilities(self) -> Capabilities:
        """What the device can do."""
        return self._backend.capabilities

    @property
    def drive(self) -> Drive | None:
        """What the LEDs may do."""
        return self._drive

    @property
    def calibration(self) -> RingCalibration | None:
        """Level to radiant intensity."""
        return self._calibration

    def set_levels(
        self, levels: Sequence[float] | None = None, *, radiant_intensity: Sequence[float] | None = None
    ) -> Frame:
        """Set every LED, all at once, and read back.

        Parameters
        ----------
        levels : sequence of float, optional
            Of each LED: 0 is off, 1 on all the time.
        radiant_intensity : sequence of float, optional
            Instead: along each LED's axis, through the calibration [W sr^-1].

        Returns
        -------
        Frame
            What was sent, and what the device holds.

        Raises
        ------
        InputError
            If a limit is exceeded, the calibration does not reach so far, or there is no drive or calibration.
        EnvironmentFailure
            If the device or the guardian fails; then the ring was turned off, as far as it could be reached.
        """
        if (levels is None) == (radiant_intensity is None):
            raise InputError("give levels or radiant intensities")
        if levels is None:
            levels = self.levels_of(radiant_intensity or ())
        frame = self.frame_of(levels)
        lit = any(frame.steps)
        with self._careful():
            if lit and self._guardian is not None:
                self._guardian.watch(self._max_on_time)
            if lit:
                # Before it is sent: interrupted within, it may shine, and only `off` knows that it does not.
                self._lit_since = time.monotonic()
            held = self._backend.show(frame.steps)
            self._lit_since = time.monotonic() if lit else None
            if not lit and self._guardian is not None:
                self._guardian.rest()
        return replace(frame, held=tuple(step / self._backend.capabilities.steps for step in held))

    def levels_of(self, radiant_intensity: Sequence[float]) -> tuple[float, ...]:
        """Level of each LED that gives a radiant intensity along its axis [W sr^-1], by the calibration.

        Raises
        ------
        InputError
            If there is no calibration, or it does not reach so far.
        """
        if self._calibration is None:
            raise InputError("radiant intensities need a calibration", remedy="give `calibration`, or levels")
        return levels_for(self._calibration, radiant_intensity)

    def frame_of(self, levels: Sequence[float]) -> Frame:
        """What the ring will show where everything goes well.

        Raises
        ------
        InputError
            If there must be no light, a limit is exceeded, or an LED that is to shine would be dark.
        """
        wanted = tuple(float(level) for level in levels)
        told = self._backend.capabilities
        if self._drive is not None:
            steps = self._drive.to_steps(wanted, told.steps)
        elif len(wanted) == told.count and not any(wanted):
            steps = (0,) * told.count
        else:
            raise InputError("the LEDs' rated current is not known, so there must be no light", remedy="give `drive`")
        return Frame(wanted, steps, tuple(step / told.steps for step in steps), told.readback, told.emulated)

    def off(self) -> None:
        """Every LED off, whatever happened before."""
        with self._careful():
            self._turn_off()

    def readback(self) -> tuple[float, ...] | None:
        """Levels as the device holds them now; None where it does not tell."""
        with self._careful():
            held = self._backend.readback()
        return None if held is None else tuple(step / self._backend.capabilities.steps for step in held)

    def check(self) -> None:
        """Raise what went wrong since: light that lasted too long, a lost guardian, a hang."""
        with self._lock:
            if self._trouble is not None:
                raise self._trouble

    def close(self) -> None:
        """Every LED off, then let the device go."""
        if self._closed.is_set():
            return
        self._closed.set()
        atexit.unregister(self.close)
        with self._lock:
            try:
                self._turn_off()
            finally:
                # A guardian that hears no farewell, only the end, tries on its own.
                if self._lit_since is None and self._guardian is not None:
                    self._guardian.close()
                with suppress(OSError):
                    self._backend.close()
        self._beats.join()

    def __enter__(self) -> LedRing:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except RadwrapError:
            if kind is None:
                raise
            # What went wrong first is what is told; the guardian sees to the light.

    @contextmanager
    def _careful(self) -> Iterator[None]:
        """One operation on the device: alone, watched, and dark if it fails."""
        with self._lock:
            if self._closed.is_set():
                raise EnvironmentFailure("is closed", where="LED ring")
            if self._trouble is not None:
                raise self._trouble
            self._busy_since = time.monotonic()
            try:
                yield
            except BaseException:
                with suppress(RadwrapError):
                    self._turn_off()
                raise
            finally:
                self._busy_since = None

    @property
    def _max_on_time(self) -> float:
        return math.inf if self._drive is None else self._drive.max_on_time

    def _turn_off(self) -> None:
        self._backend.off()
        self._lit_since = None
        if self._guardian is not None:
            with suppress(RadwrapError):  # in the dark none is needed
                self._guardian.rest()

    def _beat(self) -> None:
        """In a thread of its own: heartbeats while the device obeys, and an end to light that lasts too long."""
        last = time.monotonic()
        while not self._closed.wait(BEAT):
            now = time.monotonic()
            trouble: RadwrapError | None = None
            if now - last > MISSED and self._lit_since is not None:
                trouble = EnvironmentFailure("hung, and was turned off", where="LED ring")
            last = now
            busy, lit = self._busy_since, self._lit_since
            if busy is not None and now - busy > MISSED:
                continue  # the device does not answer: that is for the guardian
            if lit is not None and now - lit > self._max_on_time:
                trouble = EnvironmentFailure(
                    f"was lit for max_on_time, {self._max_on_time:g} s, and was turned off", where="LED ring"
                )
            elif self._guardian is not None:
                try:
                    self._guardian.beat()
                except RadwrapError as error:
                    trouble = error
            if trouble is not None:
                self._end_with(trouble)
                return

    def _end_with(self, trouble: RadwrapError) -> None:
        with self._lock:
            if self._closed.is_set():
                return
            self._trouble = trouble
            with suppress(RadwrapError):
                self._turn_off()


def open_ring(
    device: Found,
    kind: Kind,
    *,
    count: int,
    drive: Drive | None = None,
    calibration: RingCalibration | None = None,
) -> LedRing:
    """Open a ring, with a claim on the device and a guardian; every LED is off.

    Parameters
    ----------
    device : Found
        Which, see `choose`.
    kind : str
        Its electronics.
    count : int
        Number of LEDs.
    drive : Drive, optional
        What the LEDs may do; without it there is no light.
    calibration : RingCalibration, optional
        Level to radiant intensity.

    Raises
    ------
    InputError
        If calibration, drive and device do not fit together.
    EnvironmentFailure
        If the device cannot be reached, or another program drives it.
    """
    if drive is not None and drive.count != count:
        raise InputError(f"is for {drive.count} LEDs, the ring has {count}", where="drive")
    claim = Claim(device.path)
    guardian = backend = None
    try:
        guardian = Guardian(device, kind, count, claim.descriptor)
        backend = open_backend(device, kind, count)
        return _ClaimedRing(backend, drive, calibration, guardian, claim)
    except BaseException:
        if backend is not None:
            backend.close()
        if guardian is not None:
            guardian.close()
        claim.release()
        raise


class _ClaimedRing(LedRing):
    """A ring whose device is ours until it is closed."""

    def __init__(
        self,
        backend: Backend,
        drive: Drive | None,
        calibration: RingCalibration | None,
        guardian: Guardian,
        claim: Claim,
    ) -> None:
        self._claim = claim
        super().__init__(backend, drive, calibration, guardian)

    def close(self) -> None:
        try:
            super().close()
        finally:
            self._claim.release()


def _check_calibration(calibration: RingCalibration, device: Capabilities, drive: Drive | None) -> None:
    where = "calibration"
    if len(calibration.leds) != device.count:
        raise InputError(f"is of {len(calibration.leds)} LEDs, the ring has {device.count}", where=where)
    if calibration.serial != device.serial:
        raise InputError(
            f'is of the ring with the serial "{calibration.serial}", this one has "{device.serial}"', where=where
        )
    if drive is not None and abs(calibration.current / drive.drive_current - 1) > _SAME_CURRENT:
        raise InputError(
            f"was measured at {calibration.current:g} A, the drive file says {drive.drive_current:g} A", where=where
        )
