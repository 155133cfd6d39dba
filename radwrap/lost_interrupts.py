"""An interrupt that came where Python cannot raise one, as in a finaliser or in a library's call back, comes again."""

from __future__ import annotations

import signal
from typing import Final

_AGAIN: Final = 0.05  # s


def interrupt_again(number: int = signal.SIGINT) -> None:
    """Have the main thread heed a signal in a moment, as if it came then."""
    import _thread
    import threading

    again = threading.Timer(_AGAIN, _thread.interrupt_main, (number,))
    again.daemon = True
    again.start()
