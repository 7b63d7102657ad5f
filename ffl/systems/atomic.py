"""Files appear whole or not at all: written aside, synced, renamed."""

from __future__ import annotations

import os
from pathlib import Path

from ffl.errors import InputError


def require_folder(path: Path, option: str = "--out") -> None:
    """Raises `InputError` where a file stands at `path` or above it, so that it can be no folder."""
    for place in (path, *path.parents):
        if place.is_dir():
            return
        if place.exists():
            raise InputError(f"{place}: is a file; give a folder for {option}")


def write_bytes(path: Path, content: bytes) -> None:
    """Replaces `path` by `content` in one step; a crash leaves the old file or the new one."""
    require_folder(path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with aside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def write_text(path: Path, content: str) -> None:
    write_bytes(path, content.encode())
