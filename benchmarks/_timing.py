"""Shared by the benchmarks: medians of several runs, and a cap for the other way of doing it."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from typing import Any


def median_seconds(work: Callable[[], Any], runs: int = 5) -> float:
    """Median wall time of `work`, after one run that is not counted (compilation, caches)."""
    work()
    taken = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return sorted(taken)[len(taken) // 2]


def capped(work: Callable[[Any], None], cap: float) -> tuple[float, bool]:
    """Wall time of `work(started)` in a process of its own, and whether it was cut at `cap` seconds.

    The clock starts when `work` calls `started.set()`, so imports and data do not count.
    """
    context = multiprocessing.get_context("fork")
    started = context.Event()
    process = context.Process(target=work, args=(started,), daemon=True)
    process.start()
    started.wait(300.0)
    begin = time.perf_counter()
    process.join(cap)
    seconds = time.perf_counter() - begin
    cut = process.is_alive()
    if cut:
        process.kill()
        process.join()
    return seconds, cut
