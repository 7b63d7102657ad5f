"""How an effect's law of motion is compiled, and what the kernel and the law say to each other.

A law is a plain function `law(p, s, io)` over three C pointers: `p` the effect's packed parameters
(input units), `s` its own state, `io` the sub-step at hand, by the indices below. It is compiled
once as a C callback of one signature and handed to the kernel as an address, so a new effect or a
new combination of effects never recompiles the kernel (measured: about 5 ns a call; the tuple of
first-class functions that numba offers costs 25 ns and is marked experimental there).

Within a sub-step of length h every signal is a straight line, mean + slope * (2 s/h - 1) for
0 <= s <= h, that matches the true signal's mean and first moment; the linear part is driven by such
lines exactly. For a force this makes impulse and first moment right wherever in the step it
switches, so velocity and position of a mass are right to second order in h and better.

Command laws map the line at MEAN, SLOPE to a new one, once per sub-step.
Force laws are given the motion at their point: X0, V0 at the start; X1, V1 at the end as they would
be without the force of this effect, all others included; and the response of the end to a unit
mean (GX, GV) and a unit slope (GX_SLOPE, GV_SLOPE). They solve for their own MEAN and SLOPE
(which hold the last iterate) and must leave `s` alone, but for scratch; FIRST marks the first call
of a sub-step, and SENT is the mean of the command that reached the plant. Laws of effects that
`remember` are called once more with COMMIT set: then X1, V1 are final, all forces included, and the
state moves on.
Output laws map MEAN, the noise-free measured value, to what the sensor says, once per sample.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

from numba import cfunc, types

TIME, STEP = 0, 1
X0, V0, X1, V1 = 2, 3, 4, 5
GX, GV, GX_SLOPE, GV_SLOPE = 6, 7, 8, 9
MEAN, SLOPE, COMMIT, FIRST = 10, 11, 12, 13
SENT = 14
IO_SIZE = 16

_PARSING = Lock()  # CPython 3.11 counts the depth of all parsing threads in one place: SystemError
_POINTER = types.CPointer(types.float64)
SIGNATURE = types.void(_POINTER, _POINTER, _POINTER)


@functools.cache
def address_of(law: Callable[[Any, Any, Any], None]) -> int:
    """Address of the compiled law; compiled at first use, then read from numba's cache."""
    return int(_compiled(law).address)


@functools.cache
def _compiled(law: Callable[[Any, Any, Any], None]) -> Any:
    _drop_stale(law)
    return cfunc(SIGNATURE, cache=True, error_model="numpy")(law)


def _drop_stale(law: Callable[[Any, Any, Any], None]) -> None:
    """Removes cached machine code of `law` that is older than the helpers it was compiled with.

    Numba looks at the file of the law alone; after a change in `solve.py` it would go on running the
    old solver without a word.
    """
    changed = max(path.stat().st_mtime for path in helpers_of(law))
    source = Path(law.__code__.co_filename)
    for index in (source.parent / "__pycache__").glob(f"{source.stem}.{law.__name__}-*.nbi"):
        try:
            if index.stat().st_mtime < changed:
                index.unlink(missing_ok=True)
        except FileNotFoundError:
            continue  # another process was faster


def helpers_of(law: Callable[..., Any]) -> set[Path]:
    """Files that the machine code of `law` is made of beside its own: this one, and those of ffl.effects
    with the constants and functions that it uses, and that these use in turn."""
    found = {Path(__file__)}
    used, todo = {law}, [law]
    while todo:
        function = todo.pop()
        imported = _imported(Path(function.__code__.co_filename))
        for name in function.__code__.co_names:
            if name in imported:
                found.add(imported[name])
            called = getattr(function.__globals__.get(name), "py_func", None)
            if called is not None and called not in used:
                used.add(called)
                todo.append(called)
    return found


@functools.cache
def _imported(source: Path) -> dict[str, Path]:
    """Names that the module `source` takes from others of ffl.effects, with the files they stand in."""
    with _PARSING:
        tree = ast.parse(source.read_text())
    return {
        alias.asname or alias.name: Path(__file__).with_name(f"{node.module.rpartition('.')[2]}.py")
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        and node.module
        and node.module.startswith("ffl.effects.")
        for alias in node.names
    }
