"""What every reader hands over: the names in a file, and their numbers on demand."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ffl.errors import InputError
from ffl.recordings.stamps import since_midnight
from ffl.systems.plant_file import suggest

Array = np.ndarray

_WITH_UNIT = re.compile(r"^(?P<name>[^\[\](){}]*\S)\s*[\[({](?P<unit>[^\[\](){}]*)[\])}]\s*$")
_OVER_UNIT = re.compile(
    r"^(?P<name>\S.*\S|\S)\s+/\s+(?P<unit>\S+)\s*$"
)  # 'Weg / mm', as norms have it


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
    aliases : other names -> names, e.g. `group.channel` of a channel whose own name is unique
    """

    source: str
    names: tuple[str, ...]
    load: Callable[[Sequence[str]], Mapping[str, Array]]
    units: Mapping[str, str]
    where: Callable[[int], str]
    aliases: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # A damaged file may hold names with line ends; nobody can map one, and errors are one line.
        object.__setattr__(self, "names", tuple(n for n in self.names if n.isprintable()))

    def find(self, name: str) -> str | None:
        """The file's own spelling of a name: as it stands, or with its unit: `pos` of `pos [mm]`."""
        known = [*self.names, *self.aliases]
        spellings = [n for n in known if n == name] or [
            n for n in known if split_unit(n)[0] == name
        ]
        spellings = [self.aliases.get(n, n) for n in spellings]
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
    """'pos [mm]' or 'pos / mm' -> ('pos', 'mm'); a name without a unit stays as it is."""
    match = _WITH_UNIT.match(name) or _OVER_UNIT.match(name)
    return (match["name"], match["unit"].strip() or None) if match else (name, None)


def as_numbers(values: object, name: str, source: str) -> Array:
    """A real float array without singleton dimensions, at most two-dimensional; dates in seconds since
    midnight of the first, as text of dates is read."""
    array = np.asarray(values)
    if array.dtype.kind in "mM":
        with suppress(TypeError, OverflowError):  # years, months, attoseconds
            array = since_midnight(array)
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


def shortest(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Names and aliases of (group, channel) pairs: a channel's own name where no other group has it,
    with `group.channel` as its alias; `group.channel` alone where several have it.

    >>> shortest([("a", "t"), ("a", "y"), ("b", "y")])
    (('t', 'a.y', 'b.y'), {'a.t': 't'})
    """
    bare = [(group, split_unit(channel)[0]) for group, channel in pairs]
    often = Counter(
        channel for _, channel in set(bare)
    )  # twice in one group is for `find` to refuse
    unique = [often[channel] == 1 for _, channel in bare]
    names = tuple(c if alone else f"{g}.{c}" for (g, c), alone in zip(pairs, unique, strict=True))
    aliases = {f"{g}.{c}": c for (g, c), alone in zip(pairs, unique, strict=True) if alone}
    return names, aliases


def sample(index: int) -> str:
    return f"sample {index}"


def unreadable(path: Path, kind: str, error: BaseException) -> InputError:
    """One line for whatever a file format's library raises on a damaged file."""
    said = " ".join(str(error).split())[:120] or type(error).__name__
    return InputError(f"{path}: cannot be read as {kind} ({said}); export it again")
