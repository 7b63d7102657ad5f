"""Ctrl-C ends the program wherever it arrives."""

import signal
import subprocess
import sys
import time

# The interrupt arrives inside a destructor, where Python would only print and forget it.
PROGRAM = """
import signal, time
from ffl.cli.interrupts import give_lost_interrupts_again

class Held:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

{given_again}
try:
    held = Held()
    del held
    time.sleep({patience})
    print("went on")
except KeyboardInterrupt:
    print("interrupted")
"""


def said_by(given_again, patience):
    program = PROGRAM.format(given_again=given_again, patience=patience)
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    return done.stdout.strip(), done.stderr


def test_an_interrupt_lost_in_a_destructor_is_given_again():
    start = time.monotonic()
    assert said_by("give_lost_interrupts_again()", 30) == ("interrupted", "")
    assert time.monotonic() - start < 20.0  # not once the wait is over


def test_without_that_it_is_lost():
    said, warned = said_by("", 0.1)
    assert said == "went on"
    assert "KeyboardInterrupt" in warned
