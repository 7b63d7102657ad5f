"""What a command says while it works (stderr) and when it is done (stdout)."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

PATIENCE = 2.0  # s before a bar appears

Advance = Callable[[float, str], None]


@contextmanager
def progress(title: str, total: float, quiet: bool = False) -> Iterator[Advance]:
    """Yields `advance(done, text)`; a bar on stderr once the work has taken two seconds.

    Nothing is shown where stderr is not a terminal, or with `quiet`.
    """
    if quiet or not sys.stderr.isatty():

        def unsaid(done: float, text: str = "") -> None:
            pass

        yield unsaid
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[text]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task(title, total=total, text="")
    start, shown = time.monotonic(), False

    def advance(done: float, text: str = "") -> None:
        nonlocal shown
        bar.update(task, completed=done, text=text)
        if not shown and time.monotonic() - start > PATIENCE:
            bar.start()
            shown = True

    try:
        yield advance
    finally:
        if shown:
            bar.stop()


@contextmanager
def working(title: str) -> Iterator[None]:
    """A moving bar on a terminal's stderr where work of unknown length takes over two seconds."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    bar.add_task(title, total=None)
    patience = threading.Timer(PATIENCE, bar.start)
    patience.daemon = True
    patience.start()
    try:
        yield
    finally:
        patience.cancel()
        patience.join()
        if bar.live.is_started:
            bar.stop()


def print_table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """A table on stdout: text left, numbers right, two blanks between columns; nothing is cut."""
    cells = [[_text(value) for value in row] for row in rows]
    widths = [
        max([len(name), *(len(row[k]) for row in cells)], default=len(name))
        for k, name in enumerate(header)
    ]
    right = [bool(rows) and all(_is_number(row[k]) for row in rows) for k in range(len(header))]

    def line(values: Sequence[str]) -> str:
        parts = zip(values, widths, right, strict=True)
        return "  ".join(v.rjust(w) if r else v.ljust(w) for v, w, r in parts).rstrip()

    print(line(header))
    print(line(["-" * width for width in widths]))
    for row in cells:
        print(line(row))


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
