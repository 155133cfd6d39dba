"""The real LED ring in the hands of one tab: lit as its knobs stand, and dark once that tab is not heard any more.

Limits are those of the drive file, which the ring itself holds. For the server's own end there is the ring's guardian.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import Any, Final

from radwrap.errors import InputError, RadwrapError
from radwrap.led.drive import check_ripple
from radwrap.led.from_scene import leds_of
from radwrap.led.ring import Frame, LedRing
from radwrap.scene.scene import Scene

MISSED: Final = 1.4  # s without a heartbeat of the page, which sends two a second
_LOOK: Final = 0.1  # s
_LONGEST_NAME: Final = 64
Opened = Callable[[], AbstractContextManager[LedRing]]


class HeldRing:
    """The ring, opened and dark; use as ``with HeldRing(opened) as ring``.

    Parameters
    ----------
    opened : callable
        Opens the ring; called again where it has ended its light by itself.

    Raises
    ------
    InputError, EnvironmentFailure
        As `open_ring`.
    """

    def __init__(self, opened: Opened) -> None:
        self._opened = opened
        self._guard = threading.RLock()
        self._stack = ExitStack()
        self._ring: LedRing | None = None
        self._holder: str | None = None
        self._heard = 0.0
        self._lost = ""  # why the light ended
        self._closed = threading.Event()
        self._open()
        self._watch = threading.Thread(target=self._look_on, daemon=True)
        self._watch.start()

    def __enter__(self) -> HeldRing:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> LedRing:
        if self._ring is None:
            stack = ExitStack()
            self._ring = stack.enter_context(self._opened())
            self._stack = stack
        return self._ring

    def described(self) -> dict[str, Any]:
        """What a page shows of it."""
        with self._guard:
            told, drive = self._open().capabilities, self._open().drive
        return {
            "kind": told.kind,
            "serial": told.serial,
            "count": told.count,
            "emulated": told.emulated,
            "wavelength": None if drive is None else drive.wavelength,
            "max_on_time": None if drive is None else drive.max_on_time,
        }

    def light(self, tab: Any, scene: Scene, factors: Mapping[str, float], exposure_time: float) -> dict[str, Any]:
        """Light the ring as a scene's ring shines, each LED times the factor of its source.

        Parameters
        ----------
        tab : str
            Who asks: it holds the ring from now on.
        scene : Scene
            Whose ring it is.
        factors : Mapping
            Source -> factor on its radiant intensity; what is not named is dark.
        exposure_time : float
            During which PWM must be even enough [s].

        Returns
        -------
        dict
            ``held``: levels as the device has them, ``verified``, ``emulated``, ``note``.

        Raises
        ------
        InputError
            If another tab holds it, a limit is exceeded, or PWM makes captures worthless; the light is then as before.
        EnvironmentFailure
            If the device or its guardian fails; then it is dark.
        """
        name = _named(tab)
        with self._guard:
            self._check_holder(name)
            wanted = [factors.get(led.source, 0.0) * led.radiant_intensity for led in leds_of(scene)]
            ring = self._open()
            levels = ring.levels_of(wanted)
            note = check_ripple(levels, ring.capabilities.pwm_frequency, exposure_time) or ""
            try:
                frame: Frame = ring.set_levels(levels)
            except InputError:
                raise
            except RadwrapError:
                self._release("")
                self._end()
                raise
            self._holder, self._heard, self._lost = name, time.monotonic(), ""
        return {"held": frame.held, "verified": frame.verified, "emulated": frame.emulated, "note": note}

    def beat(self, tab: Any) -> dict[str, Any]:
        """A heartbeat of the tab that holds it; says whether it still does, and else why not."""
        with self._guard:
            if self._holder is not None and self._holder == tab:
                self._heard = time.monotonic()
                return {"held": True, "why": ""}
            return {"held": False, "why": self._lost or "another tab holds the ring"}

    def dark(self, tab: Any) -> None:
        """Off, asked for by the tab that holds it; of others it is not."""
        with self._guard:
            if self._holder == tab:
                self._release("")

    def close(self) -> None:
        """Off, and let the device go."""
        self._closed.set()
        with self._guard:
            self._end()
        self._watch.join()

    def _check_holder(self, name: str) -> None:
        if self._holder not in (None, name):
            what = "another tab holds the ring"
            raise InputError(what, where="LED ring", remedy="turn it off there")
        if self._closed.is_set():
            raise InputError("is closed", where="LED ring")

    def _release(self, why: str) -> None:
        """Nobody's any more, and dark."""
        self._holder, self._lost = None, why
        if self._ring is not None:
            try:
                self._ring.off()
            except RadwrapError:
                self._end()  # closing turns off once more; where that fails the guardian does

    def _end(self) -> None:
        self._holder, self._ring = None, None
        with suppress(RadwrapError):
            self._stack.close()

    def _look_on(self) -> None:
        """In a thread of its own, whatever else the server does."""
        while not self._closed.wait(_LOOK):
            with self._guard:
                if self._holder is None or self._ring is None:
                    continue
                if time.monotonic() - self._heard > MISSED:
                    self._release("the page was not heard, so the ring was turned off")
                    continue
                try:
                    self._ring.check()
                except RadwrapError as error:  # light that lasted too long, a lost guardian
                    self._end()
                    self._lost = str(error)


def _named(tab: Any) -> str:
    if not isinstance(tab, str) or not 1 <= len(tab) <= _LONGEST_NAME:
        raise InputError(f"must be a name of at most {_LONGEST_NAME} letters", where="tab")
    return tab
