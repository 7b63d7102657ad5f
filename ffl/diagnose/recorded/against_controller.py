"""Where u is not what the stated controller gives: the commonest mistakes, each of which makes it right
again in its own way, which is how they are told apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffl.diagnose.recorded.commands import at_limit
from ffl.diagnose.recorded.compared import factor_of
from ffl.diagnose.recorded.equation import MARGIN, ROWS, SHIFTS, Equation, behind, moved
from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

CONSISTENT = 0.02  # of the command's RMS
INEXACT = 1e-4  # of it: less is rounding
EXACTLY = 0.1  # of what is left as stated: what is left some samples later, if that is it
OVERDUE = 9  # samples
CUT = 8  # samples that must stand at the largest |u|, for it to be a limit that nobody stated
LIKE = 0.05  # of a factor: as near is that factor
TAKEN = 0.5  # of what is left of u less f: a gain that leaves more of it is not the controller's
UNIT_LEAVES = 0.1  # of y's variance: what a factor of what the plant makes of u may leave
LASTING = 50  # samples for which y must stand still, if the command is off elsewhere too
MOVES = 0.01  # of all its way: what r must do meanwhile, or y only rests
SCALED = 0.9  # decades from which a factor is a unit


@dataclass(frozen=True)
class Fault:
    """What is wrong with a recording: `where` it shows, and what to do."""

    recording: str
    kind: str
    where: str
    mend: str


@dataclass(frozen=True)
class Shift:
    """The one column that, moved by some samples against the others, leaves least of the equation."""

    left: float
    samples: int
    column: str
    others: str


@dataclass(frozen=True)
class Asked:
    """The recording against its controller's `equation`: `stated`: RMS that it leaves as it stands over
    u's, `rest`: what that is."""

    plant: Plant
    recording: Recording
    equation: Equation
    stated: float
    rest: Array

    @property
    def good(self) -> float:
        """What a mistake that is put right leaves at most."""
        if self.stated <= CONSISTENT:
            return EXACTLY * self.stated
        return min(max(0.15 * self.stated, 1e-4), 0.05)

    @property
    def near(self) -> float:
        """The same of columns that were shifted."""
        return min(max(0.3 * self.stated, 1e-4), 0.1)

    @cached_property
    def behind(self) -> tuple[float, int]:
        return behind(self.equation, SHIFTS)

    @cached_property
    def moved_by_u(self) -> tuple[float, float]:
        """(factor, share of y's variance that it leaves) of y over what the plant makes of u."""
        return factor_of(self.plant, self.recording.u[:ROWS], self.recording.y[:ROWS])

    @property
    def moves_as_it_should(self) -> bool | None:
        """Whether u moves y the way the plant's gain has it; None where that cannot be told."""
        factor = self.moved_by_u[0]
        return None if factor == 0.0 else factor > 0.0

    def moves_as_much_less(self, k: float) -> bool:
        """Whether u, `k` times what the controller gives, moves y by as much less than the plant has it: u
        was recorded in another unit. (A torque in per cent of 60 N m passed for a gain of 1.667.)"""
        factor, left = self.moved_by_u
        return left < UNIT_LEAVES and abs(factor * k - 1.0) < LIKE < abs(k - 1.0)

    @cached_property
    def shift(self) -> Shift:
        eq = self.equation
        rest, fed_back = eq.u - eq.given, eq.by_r - eq.by_y
        fed = bool(np.any(eq.f))
        command = "u with f" if fed else "u"
        found = []
        for s in (s for k in range(1, SHIFTS) for s in (k, -k)):
            output = moved(eq, rest + np.roll(eq.by_y, -s) - eq.by_y)
            asked = moved(eq, rest + eq.by_r - np.roll(eq.by_r, -s))
            found += [(output, s, "y", "u and r"), (asked, s, "r", "u and y")]
            if fed or s < 0:
                sent = moved(eq, eq.u - eq.f - np.roll(fed_back, s))
                found.append((sent, s, command, "r and y"))
        return Shift(*min(found))

    def fault(self, kind: str, where: str, mend: str) -> Fault:
        return Fault(self.recording.source, kind, where, mend)


def against_controller(
    plant: Plant, recording: Recording, equation: Equation
) -> tuple[float, Fault | None]:
    """What the stated controller leaves of u, in shares of its RMS, and the mistake behind it, if that is
    more than rounding and a little noise; or where feedback is a small part of u and its gain, put right,
    leaves next to nothing. (A controller of 0.8 times the stated gain left 1 % of u, of which f was 99 %:
    a lag and a mode, 0.97 each.)"""
    stated, rest = equation.stated()
    asked = Asked(plant, recording, equation, stated, rest)
    if stated <= CONSISTENT:
        return stated, _gain(asked) if stated > INEXACT else None
    level = float(np.abs(equation.u).max())
    if np.sum(at_limit(equation.u, level)) >= CUT:
        asked = replace(asked, equation=Equation(plant, recording, level))
        if asked.equation.stated()[0] < asked.good:
            return stated, asked.fault(
                "limit", "the limit of the command",
                f"u is what the stated controller gives, cut at {level:.6g}: state command_limit = "
                f"{level:.6g} in [machine] of the plant file",
            )  # fmt: skip
    return stated, next(fault for question in QUESTIONS if (fault := question(asked)) is not None)


def _command(asked: Asked) -> Fault | None:
    """u as a whole: its sign or unit, or r and y exchanged."""
    eq = asked.equation
    left, (k,), _ = eq.left(eq.u, [eq.given])
    if left >= asked.good:
        return None
    if abs(k + 1) < LIKE and asked.moves_as_it_should:
        return asked.fault(
            "columns", "the columns r and y",
            "u is what the controller would give with r and y exchanged, and moves y the way it "
            "should: exchange r and y in the mapping",
        )  # fmt: skip
    if abs(k + 1) < LIKE:
        return asked.fault(
            "sign", "the sign of u", "u has the opposite sign: flip it in the mapping"
        )
    if abs(np.log10(abs(k))) > SCALED:
        return asked.fault(
            "unit", "the unit of u",
            f"u is {k:.4g} times what the controller gives: correct its unit, or that of r and y, "
            "in the mapping",
        )  # fmt: skip
    if asked.moves_as_much_less(k):
        return asked.fault(
            "unit", "the unit of u",
            f"u is {k:.4g} times what the controller gives, and moves y {1.0 / k:.4g} times as much as "
            f"the plant file has it: correct its unit in the mapping, u = {{ scale = {1.0 / k:.4g} }} "
            "(times the scale it has)",
        )  # fmt: skip
    return None


def _output(asked: Asked) -> Fault | None:
    """The sign or unit of y."""
    eq = asked.equation
    left, (a, b), _ = eq.left(eq.u - eq.f, [eq.by_r, -eq.by_y])
    if not (left < asked.good and abs(a - 1) < LIKE and b != 0):
        return None
    factor = 1.0 / b
    if abs(factor + 1) < LIKE:
        return asked.fault(
            "sign", "the sign of y", "y has the opposite sign: flip it in the mapping"
        )
    if not 0.5 < factor < 2.0:
        return asked.fault(
            "unit", "the unit of y",
            f"y is {factor:.4g} times what the controller saw: correct its unit in the mapping",
        )  # fmt: skip
    return None


def _gain(asked: Asked) -> Fault | None:
    """r and y as a whole against u: their unit, their sign with the plant's, or the controller's gain."""
    eq = asked.equation
    left, (g,), _ = eq.left(eq.u - eq.f, [eq.by_r - eq.by_y])
    bare = eq.left(eq.u - eq.f)[0]  # what no feedback at all leaves, beside a large f
    if not (left < min(asked.good, TAKEN * bare, asked.behind[0], asked.shift.left)):
        return None
    if abs(np.log10(abs(g) + 1e-300)) > SCALED:
        return asked.fault(
            "unit", "the unit of r and y",
            f"r and y are {1.0 / g:.4g} times what the controller saw: correct their unit in the "
            "mapping, or the gain of [controller]",
        )  # fmt: skip
    if abs(g + 1) < LIKE and asked.moves_as_it_should is False:
        return asked.fault(
            "sign", "the sign of u and f, or of r and y",
            "u and f have the opposite sign of what the stated controller and the plant make of r and y: "
            "flip both, or r and y, in the mapping",
        )  # fmt: skip
    if abs(g - 1) > 0.01:
        return asked.fault(
            "controller", "the controller's gain",
            f"the controller that ran has {g:.4g} times the stated gain: correct [controller]",
        )  # fmt: skip
    return None


def _exchanged(asked: Asked) -> Fault | None:
    """u and y under each other's name."""
    recording = asked.recording
    other = Equation(asked.plant, replace(recording, u=recording.y, y=recording.u))
    if other.left(other.u - other.given)[0] >= asked.good:
        return None
    return asked.fault(
        "columns", "the columns u and y",
        "the stated controller gives y from u, not u from y: exchange the two in the mapping",
    )  # fmt: skip


def _error(asked: Asked) -> Fault | None:
    """The following error under y's name, in either sign: u = f + C_r r - C_y (r - b y) and, other than
    with an r that did not act, u moves r - b y more as the plant has it than it moves y."""
    eq, recording = asked.equation, asked.recording
    by_error = eq.f + eq.by_r - np.atleast_1d(eq.output.filter(recording.r[: len(eq.y)]))
    left, (b,), _ = eq.left(eq.u - by_error, [eq.by_y])
    if not (left < asked.good and abs(abs(b) - 1.0) < LIKE):
        return None
    u, y, r = recording.u[:ROWS], recording.y[:ROWS], recording.r[:ROWS]
    with np.errstate(all="ignore"):  # a plant that runs away tells nothing of the two
        better = factor_of(asked.plant, u, r - b * y)[1] < factor_of(asked.plant, u, y)[1]
    if not better:
        return None
    error, how, scale = ("r - y", "r minus", -1) if b > 0.0 else ("y - r", "r plus", 1)
    return asked.fault(
        "columns", "the column y",
        f"y is the following error {error}, not the position: map y as {how} that column, y = {{ sum = "
        f'["<r\'s column>", {{ name = "<y\'s column>", scale = {scale} }}] }} (times the scale each has)',
    )  # fmt: skip


def _shifted(asked: Asked) -> Fault | None:
    """u late (what the controller gives as a whole), or one column against the others."""
    left, late = asked.behind
    best = asked.shift
    if left < min(asked.near, best.left):
        return asked.fault("shift", "the time base", _takes_its_time(late))
    if best.left >= asked.near:
        return None
    word, count = "late" if best.samples > 0 else "early", abs(best.samples)
    plural, as_well = "sample" if count == 1 else "samples", ""
    if (best.column, word) == ("y", "early"):
        as_well = (
            f", or, where they are, y reaches the controller {count} {plural} late: give its feedback "
            f"{count} pole{'s'[: count > 1]} at 0 more"
        )
    return asked.fault(
        "shift", "the time base",
        f"{best.column} is {count} {plural} {word} against {best.others}: align the columns{as_well}",
    )  # fmt: skip


def _standing(asked: Asked) -> Fault | None:
    """The equation breaks only while y stands still at one value: frozen or clipped."""
    eq = asked.equation
    same = np.concatenate([[False], np.diff(eq.y) == 0.0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 8]
    if not runs:
        return None
    held = np.concatenate([eq.y[a:b] for a, b in runs])
    extreme = max((eq.y.max(), eq.y.min()), key=lambda v: float(np.sum(held == v)))
    # What the command asked for while y stood still, against elsewhere.
    fine = np.abs(np.diff(asked.rest, prepend=asked.rest[0]))
    inside = np.zeros(len(eq.y), bool)
    for a, b in runs:
        inside[a : min(b + 3, len(inside))] = True
    broken = np.mean(fine[inside]) >= 3 * np.mean(fine[~inside])
    longest = max(runs, key=_length)
    if not broken and _length(longest) < LASTING:
        return None
    share = float(np.sum(held == extreme)) / len(held)
    if (share > 0.6 and len(runs) > 1) or eq.y[longest[0]] == extreme:
        return asked.fault(
            "clipped_sensor", f"y clipped at {extreme:.6g}",
            "y stops at one value while the controller goes on: record the unclipped signal",
        )  # fmt: skip
    if not broken:  # a machine at rest stands still as well
        r = asked.recording.r[: len(eq.y)]
        asked_for = [run for run in runs if np.ptp(r[slice(*run)]) > MOVES * np.ptp(r)]
        longest = max(asked_for, key=_length, default=(0, 0))
        if _length(longest) < LASTING:
            return None
    step = asked.plant.sample_time
    start, stop = longest[0] * step, longest[1] * step
    return asked.fault(
        "frozen_sensor", f"y frozen from {start:.4g} to {stop:.4g} s after the start",
        "y stands still while the controller goes on: cut that stretch out of the recording",
    )  # fmt: skip


def _length(run: tuple[int, int]) -> int:
    return run[1] - run[0]


def _another(asked: Asked) -> Fault:
    return asked.fault(
        "controller", "the controller",
        f"u is not what the stated controller gives ({100 * asked.stated:.3g} % of its RMS is left): check "
        "[controller], the units and the columns; a diagnosis can do without [controller]",
    )  # fmt: skip


# In turn; the first who finds a mistake has found it.
QUESTIONS: tuple[Callable[[Asked], Fault | None], ...] = (
    _command,
    _output,
    _gain,
    _exchanged,
    _error,
    _shifted,
    _standing,
    _another,
)


def a_little_late(eq: Equation) -> tuple[int, str] | None:
    """By how many samples u comes later than the stated controller gives it, where that leaves next to
    nothing, and in words: too near for a fault, and a delay that nobody stated. (Of a voice coil at 10 kHz
    1.1 % of u a sample.)"""
    if len(eq.u) <= 2 * (SHIFTS + MARGIN):
        return None
    stated = moved(eq, eq.u - eq.given)
    left, late = behind(eq, OVERDUE)
    if not left < EXACTLY * stated:
        return None
    return (
        late,
        f"{_takes_its_time(late)} ({100.0 * stated:.2g} % of u is left as stated, {left:.1g} so)",
    )


def _takes_its_time(late: int) -> str:
    several = "s"[: late > 1]
    return (
        f"u is what the controller gives {late} sample{several} later: it takes so long to compute (give "
        f"[controller] {late} pole{several} at 0 more), or align the columns"
    )
