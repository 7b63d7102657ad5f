"""Is the recording what it says? With a known controller u = f + C_r r - C_y y to print precision, held
to the drive's limit where the plant file states one.

Whatever breaks that equation is a fault of the recording or of the stated controller, never physics:
the plant does not enter it. The commonest faults each make it right again in their own way, which
is how they are told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.recorded.commands import NEAR, at_limit, limit_of
from ffl.diagnose.recorded.compared import factor_of
from ffl.recordings import Recording
from ffl.recordings.jumps import missing_findings
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import as_state_space

CONSISTENT = 0.02  # of the command's RMS
INEXACT = 1e-4  # of it: less is rounding
EXACTLY = 0.1  # of what is left as stated: what is left some samples later, if that is it
OVERDUE = 9  # samples
SHIFTS = 64  # samples
MARGIN = 200  # the same, in which the controller forgets where it began
CUT = 8  # samples that must stand at the largest |u|, for it to be a limit that nobody stated
FEW = 0.1  # of the samples: with fewer below a limit it is none to compare by
ROWS = 20000


@dataclass(frozen=True)
class Fault:
    """What is wrong with a recording: `where` it shows, and what to do."""

    recording: str
    kind: str
    where: str
    mend: str


@dataclass(frozen=True)
class Soundness:
    """`consistency`: RMS of u - f - C_r r + C_y y over that of u, by recording (none in open loop);
    `notes`: what is too little for a fault."""

    consistency: tuple[float, ...]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...] = ()


def soundness(plant: Plant, recordings: Sequence[Recording]) -> Soundness:
    """Checks every recording against the stated controller."""
    ratios, faults = [], []
    notes: dict[int, str] = {}
    for recording in recordings:
        fault = _dead(recording) or _incomplete(recording)
        if fault is None and plant.controller is not None and "u" not in recording.missing:
            eq = _Equation(plant, recording)
            ratio, fault = _against_controller(plant, recording, eq)
            ratios.append(ratio)
            if fault is None and ratio > INEXACT and (late := _a_little_late(eq)):
                samples, told = late
                notes.setdefault(samples, f"{recording.source}: {told}")
        if fault is not None:
            faults.append(fault)
    return Soundness(tuple(ratios), tuple(faults), tuple(notes.values()))


def injected_as_sent(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Recording], list[str]]:
    """Recordings whose f is rescaled where u shows that it acted by up to a quarter more or less.

    u - C_r r + C_y y is f as it really was injected; pulses noted as 5 V that act as 5.07 V leave 3 %
    of u's RMS in the controller's equation, which is an inexact note and not another controller.
    """
    kept, notes = [], []
    for recording in recordings:
        kept.append(recording)
        if plant.controller is None or "u" in recording.missing or not np.any(recording.f):
            continue
        eq = _Equation(plant, recording)
        if not np.any(eq.f):
            continue
        fed_back = eq.u - eq.by_r + eq.by_y
        stated, _, _ = eq.left(fed_back - eq.f)
        left, (k,), _ = eq.left(fed_back, [eq.f])
        if stated > 0.002 and left < 0.4 * stated and 0.8 < k < 1.25:
            kept[-1] = replace(recording, f=k * recording.f)
            notes.append(f"{recording.source}: f acted {k:.4g} times as noted; taken as it acted")
    return kept, notes


def _dead(recording: Recording) -> Fault | None:
    """Constant signals say nothing."""
    name = recording.source
    if np.ptp(recording.y) == 0:
        return Fault(name, "constant", "y is constant", "record while the machine moves")
    drive = recording.u if np.all(np.isfinite(recording.u)) else recording.r
    if np.ptp(drive) == 0 and np.ptp(recording.r) == 0:
        return Fault(name, "constant", "u and r are constant", "record while the machine is driven")
    return None


def _incomplete(recording: Recording) -> Fault | None:
    """Samples that are missing, their time counted on."""
    for finding in missing_findings(recording):
        where, mend = finding.text.split("; ", 1)
        return Fault(recording.source, finding.kind, where, mend)
    return None


class _Equation:
    """u - f = a C_r r - b C_y y + free response of the controller, over the first rows, those at the
    `limit` of the drive left out (None: as the plant file states it)."""

    def __init__(self, plant: Plant, recording: Recording, limit: float | None = None) -> None:
        assert plant.controller is not None
        limit = limit or limit_of(plant)
        n = min(len(recording), ROWS)
        self.u, self.f = recording.u[:n], recording.f[:n]
        self.y = recording.y[:n]
        reference = as_state_space(plant.controller.reference)
        self.output = as_state_space(plant.controller.output)
        self.by_r = np.atleast_1d(reference.filter(recording.r[:n]))
        self.by_y = np.atleast_1d(self.output.filter(self.y))
        self.free = plant.controller.state_space.free_response(n)
        self.size = float(np.sqrt(np.mean(self.u**2))) or 1.0
        self.kept = ~at_limit(self.u, limit)
        # What goes beyond the limit was recorded before it, or in another unit.
        cut = limit is not None and np.abs(self.u).max() <= (1.0 + NEAR) * limit
        self.limit = limit if cut and np.mean(self.kept) > FEW else None
        if self.limit is None:
            self.kept[:] = True

    def stated(self) -> tuple[float, Array]:
        """(relative RMS of what the equation leaves of u as it stands, residual)."""
        given = self.f + self.by_r - self.by_y
        _, _, rest = self.left(self.u - given)
        if self.limit is not None:
            sent = np.clip(self.u - rest, -self.limit, self.limit)
            rest = np.where(self.kept, rest, self.u - sent)
        return float(np.sqrt(np.mean(rest**2))) / self.size, rest

    def left(self, target: Array, columns: Sequence[Array] = ()) -> tuple[float, Array, Array]:
        """(relative RMS of what is left below the limit, coefficients of the columns, residual)."""
        table = np.column_stack([*columns, self.free]) if len(columns) else self.free
        if table.shape[1] == 0:
            return float(np.sqrt(np.mean(target[self.kept] ** 2))) / self.size, np.zeros(0), target
        own = table[self.kept]
        scale = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        solution = np.linalg.lstsq(own / scale, target[self.kept], rcond=1e-12)[0] / scale
        rest = target - table @ solution
        size = float(np.sqrt(np.mean(rest[self.kept] ** 2)))
        return size / self.size, solution[: len(columns)], rest


def stated_ratio(plant: Plant, recording: Recording) -> float:
    """RMS of u - f - C_r r + C_y y over that of u, with the stated controller."""
    return _Equation(plant, recording).stated()[0]


def _against_controller(
    plant: Plant, recording: Recording, eq: _Equation
) -> tuple[float, Fault | None]:
    name = recording.source
    stated, rest = eq.stated()
    if stated <= CONSISTENT:
        return stated, None
    good = min(max(0.15 * stated, 1e-4), 0.05)

    def fault(kind: str, where: str, mend: str) -> tuple[float, Fault]:
        return stated, Fault(name, kind, where, mend)

    level = float(np.abs(eq.u).max())
    if np.sum(at_limit(eq.u, level)) >= CUT:
        eq = _Equation(plant, recording, level)
        if eq.stated()[0] < good:
            return fault(
                "limit", "the limit of the command",
                f"u is what the stated controller gives, cut at {level:.6g}: state command_limit = "
                f"{level:.6g} in [machine] of the plant file",
            )  # fmt: skip
    # u as a whole: sign or unit.
    left, (k,), _ = eq.left(eq.u, [eq.f + eq.by_r - eq.by_y])
    if left < good:
        if abs(k + 1) < 0.05 and factor_of(plant, recording.u[:ROWS], recording.y[:ROWS])[0] > 0.0:
            return fault(
                "columns", "the columns r and y",
                "u is what the controller would give with r and y exchanged, and moves y the way it "
                "should: exchange r and y in the mapping",
            )  # fmt: skip
        if abs(k + 1) < 0.05:
            return fault("sign", "the sign of u", "u has the opposite sign: flip it in the mapping")
        if abs(np.log10(abs(k))) > 0.9:
            return fault(
                "unit", "the unit of u",
                f"u is {k:.4g} times what the controller gives: correct its unit, or that of r and y, "
                "in the mapping",
            )  # fmt: skip
    # y: sign or unit.
    left, (a, b), _ = eq.left(eq.u - eq.f, [eq.by_r, -eq.by_y])
    if left < good and abs(a - 1) < 0.05 and b != 0:
        factor = 1.0 / b
        if abs(factor + 1) < 0.05:
            return fault("sign", "the sign of y", "y has the opposite sign: flip it in the mapping")
        if not 0.5 < factor < 2.0:
            return fault(
                "unit", "the unit of y",
                f"y is {factor:.4g} times what the controller saw: correct its unit in the mapping",
            )  # fmt: skip
    # u late (what the controller gives as a whole), or y or r late or early.
    near = min(max(0.3 * stated, 1e-4), 0.1)
    given = eq.f + eq.by_r - eq.by_y
    behind, late = _behind(eq, SHIFTS)
    shifts = [s for k in range(1, SHIFTS) for s in (k, -k)]
    fed, fed_back = bool(np.any(eq.f)), eq.by_r - eq.by_y
    best, at, column, others = min(
        *(
            (_moved(eq, eq.u - given + np.roll(eq.by_y, -s) - eq.by_y), s, "y", "u and r")
            for s in shifts
        ),
        *(
            (_moved(eq, eq.u - given + eq.by_r - np.roll(eq.by_r, -s)), s, "r", "u and y")
            for s in shifts
        ),
        *(
            (
                _moved(eq, eq.u - eq.f - np.roll(fed_back, s)),
                s,
                "u with f" if fed else "u",
                "r and y",
            )
            for s in shifts
            if fed or s < 0
        ),
    )
    left, (g,), _ = eq.left(eq.u - eq.f, [eq.by_r - eq.by_y])
    alike = left < min(good, behind, best)
    if alike and abs(np.log10(abs(g) + 1e-300)) > 0.9:
        return fault(
            "unit", "the unit of r and y",
            f"r and y are {1.0 / g:.4g} times what the controller saw: correct their unit in the "
            "mapping, or the gain of [controller]",
        )  # fmt: skip
    if (
        alike
        and abs(g + 1) < 0.05
        and factor_of(plant, recording.u[:ROWS], recording.y[:ROWS])[0] < 0.0
    ):
        return fault(
            "sign", "the sign of u and f, or of r and y",
            "u and f have the opposite sign of what the stated controller and the plant make of r and y: "
            "flip both, or r and y, in the mapping",
        )  # fmt: skip
    if alike and abs(g - 1) > 0.01:
        return fault(
            "controller", "the controller's gain",
            f"the controller that ran has {g:.4g} times the stated gain: correct [controller]",
        )  # fmt: skip
    if _exchanged(plant, recording) < good:
        return fault(
            "columns", "the columns u and y",
            "the stated controller gives y from u, not u from y: exchange the two in the mapping",
        )  # fmt: skip
    if behind < min(near, best):
        return fault("shift", "the time base", _takes_its_time(late))
    if best < near:
        word, plural = "late" if at > 0 else "early", "sample" if abs(at) == 1 else "samples"
        as_well = ""
        if (column, word) == ("y", "early"):
            as_well = (
                f", or, where they are, y reaches the controller {abs(at)} {plural} late: give its "
                f"feedback {abs(at)} pole{'s'[: abs(at) > 1]} at 0 more"
            )
        return fault(
            "shift", "the time base",
            f"{column} is {abs(at)} {plural} {word} against {others}: align the columns{as_well}",
        )  # fmt: skip
    local = _local(eq, rest, plant.sample_time, name)
    if local is not None:
        return stated, local
    return fault(
        "controller", "the controller",
        f"u is not what the stated controller gives ({100 * stated:.3g} % of its RMS is left): check "
        "[controller], the units and the columns; a diagnosis can do without [controller]",
    )  # fmt: skip


def _a_little_late(eq: _Equation) -> tuple[int, str] | None:
    """By how many samples u comes later than the stated controller gives it, where that leaves next to
    nothing, and in words: too near for a fault, and a delay that nobody stated. (Of a voice coil at 10 kHz
    1.1 % of u a sample.)"""
    if len(eq.u) <= 2 * (SHIFTS + MARGIN):
        return None
    stated = _moved(eq, eq.u - eq.f - eq.by_r + eq.by_y)
    behind, late = _behind(eq, OVERDUE)
    if not behind < EXACTLY * stated:
        return None
    return (
        late,
        f"{_takes_its_time(late)} ({100.0 * stated:.2g} % of u is left as stated, {behind:.1g} so)",
    )


def _takes_its_time(late: int) -> str:
    several = "s"[: late > 1]
    return (
        f"u is what the controller gives {late} sample{several} later: it takes so long to compute (give "
        f"[controller] {late} pole{several} at 0 more), or align the columns"
    )


def _behind(eq: _Equation, most: int) -> tuple[float, int]:
    """What is left of u where it is what the controller gives some samples later, fewer than `most`, and
    how many leave least."""
    given = eq.f + eq.by_r - eq.by_y
    return min((_moved(eq, eq.u - np.roll(given, k)), k) for k in range(1, most))


def _moved(eq: _Equation, part: Array) -> float:
    """RMS of what is left of u, in shares of it, away from the ends."""
    within = slice(SHIFTS + MARGIN, len(part) - SHIFTS)
    part = part[within][eq.kept[within]]
    part = part - np.mean(part) if eq.free.shape[1] else part
    return float(np.sqrt(np.mean(part**2))) / eq.size


def _exchanged(plant: Plant, recording: Recording) -> float:
    """What the controller's equation leaves with u and y exchanged, in shares of u."""
    other = _Equation(plant, replace(recording, u=recording.y, y=recording.u))
    return other.left(other.u - other.f - other.by_r + other.by_y)[0]


def _local(eq: _Equation, rest: Array, sample_time: float, name: str) -> Fault | None:
    """The equation breaks only while y stands still at one value: frozen or clipped."""
    same = np.concatenate([[False], np.diff(eq.y) == 0.0])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    runs = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 8]
    if not runs:
        return None
    held = np.concatenate([eq.y[a:b] for a, b in runs])
    extreme = max((eq.y.max(), eq.y.min()), key=lambda v: float(np.sum(held == v)))
    # What the command asked for while y stood still, against elsewhere.
    fine = np.abs(np.diff(rest, prepend=rest[0]))
    inside = np.zeros(len(eq.y), bool)
    for a, b in runs:
        inside[a : min(b + 3, len(inside))] = True
    longest = max(runs, key=lambda run: run[1] - run[0])
    if np.mean(fine[inside]) < 3 * np.mean(fine[~inside]) and longest[1] - longest[0] < 50:
        return None
    share = float(np.sum(held == extreme)) / len(held)
    if (share > 0.6 and len(runs) > 1) or eq.y[longest[0]] == extreme:
        return Fault(
            name, "clipped_sensor", f"y clipped at {extreme:.6g}",
            "y stops at one value while the controller goes on: record the unclipped signal",
        )  # fmt: skip
    start, stop = longest[0] * sample_time, longest[1] * sample_time
    return Fault(
        name, "frozen_sensor", f"y frozen from {start:.4g} to {stop:.4g} s after the start",
        "y stands still while the controller goes on: cut that stretch out of the recording",
    )  # fmt: skip
