"""Independent pieces of work, shared out between the caller and idle threads.

Kernels, factorisations, transforms and whitening leave the interpreter to others, so that threads do:
nothing is copied, and every piece is what it would be alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

THREADS = 2
_POOL = ThreadPoolExecutor(THREADS)


def each(work: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """[work(item) for item in items] with an idle thread's help, in the order of `items`.

    The caller works as well and waits for no thread that has not begun: pieces of work may share out
    their own pieces in the same way. An exception of one piece is raised once all that run have ended.
    """
    waiting = list(items)
    if len(waiting) < 2:
        return [work(item) for item in waiting]
    done: dict[int, R] = {}
    queue = deque(enumerate(waiting))

    def drain() -> None:
        while queue:
            try:
                k, item = queue.popleft()
            except IndexError:  # the other was faster
                return
            done[k] = work(item)

    helper = _POOL.submit(copy_context().run, drain)  # numpy's error state belongs to the context
    try:
        drain()
    finally:
        queue.clear()
        if not helper.cancel():
            helper.result()
    return [done[k] for k in range(len(waiting))]
