"""Ctrl-C that arrives where Python cannot pass it on is given again.

An interrupt raised inside a destructor or a weak reference's callback is printed as "Exception
ignored" and lost: the work goes on to its end as if nobody had pressed a key.
"""

from __future__ import annotations

import _thread
import sys
import threading

SOON = 0.01  # s


def give_lost_interrupts_again() -> None:
    """From now on an ignored KeyboardInterrupt reaches the main thread again, 10 ms later."""

    def ignored(lost: sys.UnraisableHookArgs) -> None:
        if issubclass(lost.exc_type, KeyboardInterrupt):
            threading.Timer(SOON, _thread.interrupt_main).start()
        else:
            sys.__unraisablehook__(lost)

    sys.unraisablehook = ignored
