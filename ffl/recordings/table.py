"""What every reader hands over: the names in a file, and their numbers on demand."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.systems.plant_file import suggest

Array = np.ndarray

_WITH_UNIT = re.compile(r"^(?P<name>[^\[\](){}]*\S)\s*[\[({](?P<unit>[^\[\](){}]*)[\])}]\s*$")


@dataclass(frozen=True)
class Table:
    """Named arrays of one file.

    Attributes
    ----------
    source : the file, as errors name it
    names : what can be asked for, nested names joined by dots
    load : names -> arrays as the file holds them, any shape; reads no more than it is asked for
    units : units that the file itself states, by name
    where : sample index -> the place in the file, e.g. "line 12"
    """

    source: str
    names: tuple[str, ...]
    load: Callable[[Sequence[str]], Mapping[str, Array]]
    units: Mapping[str, str]
    where: Callable[[int], str]

    def __post_init__(self) -> None:
        # A damaged file may hold names with line ends; nobody can map one, and errors are one line.
        object.__setattr__(self, "names", tuple(n for n in self.names if n.isprintable()))

    def find(self, name: str) -> str | None:
        """The file's own spelling of a name: as it stands, or with its unit: `pos` of `pos [mm]`."""
        spellings = [n for n in self.names if n == name] or [
            n for n in self.names if split_unit(n)[0] == name
        ]
        if len(spellings) > 1:
            raise InputError(
                f"{self.source}: column '{name}' stands there {len(spellings)} times; rename all "
                "but one"
            )
        return spellings[0] if spellings else None

    def numbers(self, names: Sequence[str]) -> dict[str, Array]:
        """Float arrays with at most two dimensions, by the names asked for."""
        spelled = {}
        for name in names:
            found = self.find(name)
            if found is None:
                near = suggest(name, [split_unit(n)[0] for n in self.names[:20]])
                raise InputError(f"{self.source}: no column '{name}'; {near}")
            spelled[name] = found
        loaded = self.load(list(dict.fromkeys(spelled.values())))
        return {n: as_numbers(loaded[own], n, self.source) for n, own in spelled.items()}

    def unit(self, name: str) -> str | None:
        found = self.find(name)
        return None if found is None else (self.units.get(found) or split_unit(found)[1])


def split_unit(name: str) -> tuple[str, str | None]:
    """'pos [mm]' -> ('pos', 'mm'); a name without a unit stays as it is."""
    match = _WITH_UNIT.match(name)
    return (match["name"], match["unit"].strip() or None) if match else (name, None)


def as_numbers(values: object, name: str, source: str) -> Array:
    """A real float array without singleton dimensions, at most two-dimensional."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise InputError(
            f"{source}: '{name}' does not hold real numbers (it is {array.dtype}); map another name"
        )
    array = array.astype(float).squeeze()
    if array.ndim > 2:
        raise InputError(
            f"{source}: '{name}' has {array.ndim} dimensions {array.shape}; give one value per "
            "sample, or a table of them"
        )
    return array


def sample(index: int) -> str:
    return f"sample {index}"


def unreadable(path: Path, kind: str, error: BaseException) -> InputError:
    """One line for whatever a file format's library raises on a damaged file."""
    said = " ".join(str(error).split())[:120] or type(error).__name__
    return InputError(f"{path}: cannot be read as {kind} ({said}); export it again")
