"""Ctrl-C that arrives where Python cannot pass it on is given again.

An interrupt raised inside a destructor or a weak reference's callback is printed as "Exception
ignored" and lost: the work goes on to its end as if nobody had pressed a key.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading

SOON = 0.01  # s


def give_lost_interrupts_again() -> None:
    """From now on an ignored KeyboardInterrupt reaches the main thread again, 10 ms later."""

    def ignored(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            threading.Timer(SOON, _interrupt).start()
        else:
            sys.__unraisablehook__(lost)

    sys.unraisablehook = ignored


def _interrupt() -> None:
    """As Ctrl-C does: what the main thread waits for is broken off too, where the system can."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
