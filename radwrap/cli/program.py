"""``radwrap`` as a process of its own: its signals, its streams and its end.

Until the signals are ours, an interrupt is Python's; so this module is small,
and what takes long to load comes after that.
"""

import os
import sys
from contextlib import suppress

from radwrap.cli.interrupts import Interrupts


def program() -> None:
    """Run the command as a process of its own, and end that with its exit code.

    To free piece by piece what the process leaves behind would take some per
    cent of a small run's time.
    """
    interrupts = Interrupts()
    interrupts.install()
    sys.unraisablehook = interrupts.unraisable

    from radwrap.cli.streams import prepare_streams

    prepare_streams()

    import atexit
    import threading

    from radwrap.cli.main import main

    code = main(sys.argv[1:], interrupts)
    if threading.active_count() > 1:
        sys.exit(code)
    atexit._run_exitfuncs()
    with suppress(OSError):  # what `main` could not write it told
        sys.stdout.flush()
    os._exit(code)
