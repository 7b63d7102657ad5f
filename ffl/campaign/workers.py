"""Worker processes that compute trials, hand them to the parent one by one, and die with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait

from ffl.campaign.config import Campaign
from ffl.campaign.trials import Event, run_trials
from ffl.errors import InputError, WorkError
from ffl.learn import Trial


def die_with_parent() -> None:
    """Ends this process when its parent ends, however that happens.

    Linux: the kernel sends SIGKILL. Everywhere: a thread waits on the parent's sentinel, which also
    covers a parent that was gone before the first call took effect.
    """
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    parent = multiprocessing.parent_process()
    if parent is not None:

        def watch() -> None:
            wait([parent.sentinel])
            os._exit(1)

        threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """A process started here ignores Ctrl-C from its first instruction: the parent decides."""
    if threading.current_thread() is not threading.main_thread():  # may not touch signals
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


Job = tuple[str, Trial | None, bool]


def _work(campaign: Campaign, link: Connection) -> None:
    """Runs jobs until None comes; sends (kind, event) and goes on when the parent has stored it."""
    die_with_parent()
    while (job := link.recv()) is not None:
        try:
            for event in run_trials(campaign, *job):
                link.send(("event", event))
                link.recv()
            link.send(("end", None))
        except InputError as error:
            link.send(("input", str(error)))
        except Exception as error:
            link.send(("work", f"{type(error).__name__}: {error}"))


def events(
    campaign: Campaign, jobs: list[Job], n_workers: int
) -> Generator[tuple[str, Event], None, None]:
    """(run name, event) of all jobs; a worker waits until the caller asks for the next event.

    With one worker everything happens in this process.
    """
    if n_workers <= 1 or len(jobs) <= 1:
        for name, after, carried_over in jobs:
            for event in run_trials(campaign, name, after, carried_over):
                yield name, event
        return
    context = multiprocessing.get_context("spawn")
    waiting = list(reversed(jobs))
    processes, busy = [], {}
    try:
        for _ in range(min(n_workers, len(jobs))):
            link, far = context.Pipe()
            process = context.Process(target=_work, args=(campaign, far), daemon=True)
            with _deaf_to_interrupts():
                process.start()
            far.close()
            processes.append(process)
            job = waiting.pop()
            link.send(job)
            busy[link] = job[0]
        while busy:
            for link in wait(list(busy)):  # type: ignore[assignment]  # of those given
                name = busy[link]
                try:
                    kind, value = link.recv()
                except EOFError:
                    raise WorkError(
                        f"run '{name}': its worker process ended; go on with --resume"
                    ) from None
                if kind == "event":
                    yield name, value
                    link.send("stored")
                elif kind == "input":
                    raise InputError(value)
                elif kind == "work":
                    raise WorkError(f"run '{name}': {value}")
                elif waiting:
                    job = waiting.pop()
                    busy[link] = job[0]
                    link.send(job)
                else:
                    link.send(None)
                    del busy[link]
    finally:
        for process in processes:
            if process.is_alive() and busy:
                process.kill()
            process.join()
