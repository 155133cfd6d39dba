"""An interrupt that came where Python cannot raise one, as in a finaliser or in a library's call back, comes again."""

from __future__ import annotations

import signal
from typing import Final

_AGAIN: Final = 0.05  # s


def interrupt_again(number: int = signal.SIGINT) -> None:
    """Send the main thread a signal in a moment. It is a real one, so that a sleep or a wait for a lock ends too."""
    import threading

    again = threading.Timer(_AGAIN, signal.pthread_kill, (threading.main_thread().ident, number))
    again.daemon = True
    again.start()
