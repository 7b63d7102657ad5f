"""Files appear whole or not at all: written aside, synced, renamed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ffl.errors import InputError

REFUSED = (PermissionError, FileNotFoundError, IsADirectoryError, NotADirectoryError)


def require_folder(path: Path, option: str = "--out") -> None:
    """Raises `InputError` where a file stands at `path` or above it, so that it can be no folder."""
    for place in (path, *path.parents):
        if place.is_dir():
            return
        if place.exists():
            raise InputError(f"{place}: is a file; give a folder for {option}")


def require_own(folder: Path, key: str) -> None:
    """Raises `InputError` where `folder` is no place for an answer with `key`: it is a file, or its
    report.html is another command's and would be lost."""
    require_folder(folder)
    if not (folder / "report.html").exists():
        return
    try:
        answer = json.loads((folder / "answer.json").read_text())
    except (OSError, ValueError):
        answer = None
    if not isinstance(answer, dict) or key not in answer:
        raise InputError(f"{folder}: holds the report of another command; give another --out")


def require_replaceable(path: Path, own: Callable[[bytes], bool]) -> None:
    """Raises `InputError` where a file stands at `path` that is not `own`: not an earlier output of the
    command that is about to write there, which would be lost."""
    if path.is_file() and not own(path.read_bytes()):
        raise InputError(
            f"{path}: stands there already and is no earlier output of this command; give another "
            "--out, or move it away"
        )


@contextmanager
def written_aside(path: Path) -> Iterator[Path]:
    """The file beside `path` to write first, taken away in the end; where it cannot be written, that
    is said of `path`."""
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield aside
    except OSError as error:
        why = error.strerror or str(error)
        if isinstance(error, REFUSED):
            raise InputError(
                f"{path}: cannot be written: {why}; give another --out, or mend what stands there"
            ) from None
        raise OSError(error.errno, why, str(path)) from None
    finally:
        with suppress(OSError):
            aside.unlink(missing_ok=True)


def write_bytes(path: Path, content: bytes) -> None:
    """Replaces `path` by `content` in one step; a crash leaves the old file or the new one."""
    require_folder(path.parent)
    with written_aside(path) as aside:
        path.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)


def write_text(path: Path, content: str) -> None:
    write_bytes(path, content.encode())
