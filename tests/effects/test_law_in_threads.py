"""Helpers of a law are read by several threads at once."""

from __future__ import annotations

import gc
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ffl.effects import law

TIMES = 60  # without a lock one of them fails in five runs of five


@pytest.fixture
def interrupted():  # type: ignore[no-untyped-def]
    """Threads take turns at every collection, and there are many."""
    thresholds = gc.get_threshold()

    def yielding(phase, info):  # type: ignore[no-untyped-def]
        time.sleep(0)

    gc.callbacks.append(yielding)
    gc.set_threshold(20, 1, 1)
    yield
    gc.set_threshold(*thresholds)
    gc.callbacks.remove(yielding)


def test_threads_read_the_imports_of_a_law_at_once(interrupted):  # type: ignore[no-untyped-def]
    source = Path(law.__file__).with_name("backlash.py")
    read = law._imported.__wrapped__  # every time anew

    def deeper(levels):  # type: ignore[no-untyped-def]
        return deeper(levels - 1) if levels else [read(source) for _ in range(TIMES)]

    with ThreadPoolExecutor(2) as pool:
        told = [names for found in pool.map(deeper, (0, 150)) for names in found]
    assert all(names == told[0] for names in told)
    assert told[0]
