"""Independent pieces of work, shared out between the caller and idle threads.

Kernels, factorisations, transforms and whitening leave the interpreter to others, so that threads do:
nothing is copied, and every piece is what it would be alone. Whether it pays is seen as it goes: threads
that take the interpreter from one another (recordings of some thousand samples) were no faster than one,
and cost a quarter more of the processor; nor are they where other processes have all of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from time import perf_counter, thread_time
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

THREADS = 2
PAYS = 1.15  # times as fast as one thread: what sharing out must bring
REST = 30  # calls of the same kind that are not shared out where it did not
SHARED = True  # False where other processes are known to have every core
_POOL = ThreadPoolExecutor(THREADS)
_RESTS: dict[object, int] = {}  # calls left, by the code of the work


def each(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """[work(item) for item in items] with an idle thread's help, in the order of `items`.

    The caller works as well and waits for no thread that has not begun: pieces of work may share out
    their own pieces in the same way. An exception of one piece is raised once all that run have ended.
    """
    waiting = list(items)
    kind = getattr(work, "__code__", None)
    rests = _RESTS.get(kind, 0)
    if len(waiting) < 2 or rests or not SHARED:
        _RESTS[kind] = max(rests - 1, 0)
        return [work(item) for item in waiting]
    done: dict[int, R] = {}
    queue = deque(enumerate(waiting))
    worked = [0.0, 0.0]  # s of the processor, by the caller and by its helper

    def drain(who: int) -> None:
        begun = thread_time()
        try:
            while queue:
                try:
                    k, item = queue.popleft()
                except IndexError:  # the other was faster
                    return
                done[k] = work(item)
        finally:
            worked[who] = thread_time() - begun

    begun = perf_counter()
    # Numpy's error state belongs to the context.
    helper = _POOL.submit(copy_context().run, drain, 1)
    try:
        drain(0)
    finally:
        queue.clear()
        if not helper.cancel():
            helper.result()
    if sum(worked) < PAYS * (perf_counter() - begun):
        _RESTS[kind] = REST
    return [done[k] for k in range(len(waiting))]
