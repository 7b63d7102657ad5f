"""Is what was recorded what the plant file means? Units, signs and columns that no controller tells.

Where a plant file and a header name units that measure the same, their factor is known. What the model
makes of u is laid beside y: the same but for a factor that no model is off by, or in open loop for a sign
or with u and y exchanged, is no physics, unless forces that grow otherwise than in proportion explain y
better. What integrates is looked at above a corner, where it forgets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.optimize

from ffl.diagnose.recorded.against_controller import Fault
from ffl.diagnose.recorded.compared import compared, factor_of, held_by, moved_by
from ffl.diagnose.recorded.early import early
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.recordings.units import NEAR, factor_between, looks_like
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import Zpk

ALIKE = 0.2  # of y's variance: what a factor must leave at most to be all that is wrong
# The same of a moderate factor in a loop whose stated controller makes u of r and y. (A throttle's spring,
# preloaded on both sides, and its friction made 0.29 to 0.32 of y, all but 0.10 to 0.13 of it.)
LEAVES = 0.05
UNALIKE = 0.5  # and with u and y as they are named, if these are exchanged
SAME = 0.02  # the same with u and y exchanged
FACTOR = 3.0  # by which no model is off
OFF = 1.25  # by which a factor is one
UNEVEN = 1.5  # by which two are not the same
MODERATE = 30.0  # what friction may make of a factor; units are further off
TURNED = 0.35  # of y's variance: what u with its sign turned must leave at most
HOLD = 2  # of the forces along the motion: drag and dry friction, which only ever hold it back
LONGEST = 20000  # samples looked at
UNSURE = 0.1  # of a factor: a doubt beyond it fits any unit
BETTER = 0.25  # of what a factor leaves: what such forces must leave at most to speak against it
LEVELS = (0.1, 0.25, 0.5, 0.75, 0.9)  # shares of the commands within the limits that are tried, and
# limits by the largest: a controller winds up beyond its drive's.
OF_LARGEST = np.geomspace(1e-4, 0.5, 8)
DEAD = np.geomspace(0.01, 0.5, 12)  # of the largest command: dead zones


def mistakes(
    plant: Plant, recordings: Sequence[Recording], known: tuple[Fault, ...] = ()
) -> tuple[Fault, ...]:
    """What the headers say; else faults `known` by the controller's equation; else what the model
    says."""
    named = tuple(fault for r in recordings if (fault := in_other_units(plant, r)))
    if named or known:
        return named or known
    made = {k: fault for k, r in enumerate(recordings) if (fault := mistaken(plant, r))}
    return tuple(
        fault for k, fault in made.items()
        if fault.kind != "unit"
        or not _by_amplitude(plant, recordings[k], [*recordings[:k], *recordings[k + 1 :]])
    )  # fmt: skip


def _by_amplitude(plant: Plant, recording: Recording, others: Sequence[Recording]) -> bool:
    """Whether what passes for a factor in `recording` is none of the machine's: a moderate one, where of
    other recordings no factor explains y, or another one that is on the same side of 1. (Dry friction left
    0.18 of what the model makes of a small multisine; of its moves a factor left seven and eight tenths. A
    pump's slide made 0.12 of it in large moves, 0.05 and 0.03 in small ones.)"""
    factor, _ = _looked_at(plant, recording)
    if not 1.0 / MODERATE < abs(factor) < MODERATE:
        return False
    for r in others:
        if "u" in r.missing or not np.all(np.isfinite(r.u)):
            continue
        other, left = _looked_at(plant, r)
        if left > UNALIKE:
            return True
        if other <= 0.0 or factor <= 0.0:
            continue
        off, own = np.log(other), np.log(factor)
        if off * own > 0.0 and abs(off) > np.log(OFF) and abs(off - own) > np.log(UNEVEN):
            return True
    return False


def _looked_at(plant: Plant, recording: Recording) -> tuple[float, float]:
    """`factor_of` the samples looked at."""
    return factor_of(plant, recording.u[:LONGEST], recording.y[:LONGEST])


def in_other_units(plant: Plant, recording: Recording) -> Fault | None:
    """A header that names another unit for y, r or u than the plant file."""
    for columns, meant in (("yr", plant.output_unit), ("uf", plant.input_unit)):
        first = recording.units.get(columns[0], "")
        factor = factor_between(first, meant) if first and meant else None
        if factor is None or abs(factor - 1.0) < 1e-9:
            continue
        also = " and ".join(c for c in columns if recording.units.get(c) == first)
        return Fault(
            recording.source, "unit", f"the unit of {also}",
            f"the file has {also} in {first}, the plant file in {meant}: give scale = {factor:.6g} and "
            f'unit = "{meant}" for {also} in the mapping, or state the plant in {first}',
        )  # fmt: skip
    return None


def mistaken(plant: Plant, recording: Recording) -> Fault | None:
    """Unit, and in open loop sign, columns or time base, by what the model makes of u."""
    if plant.effects or "u" in recording.missing or recording.d is not None:
        return None
    n = min(len(recording), LONGEST)
    u, y = recording.u[:n], recording.y[:n]
    if not np.all(np.isfinite(u)) or (np.abs(plant.system.poles) > 1.0 + 1e-9).any():
        return None
    factor, left = factor_of(plant, u, y)
    name, alone = recording.source, plant.controller is None
    back, unlike = factor_of(plant, y, u)
    exchanged = alone and 1.0 / FACTOR < back < FACTOR and unlike < SAME
    if exchanged and (left > UNALIKE or not 1.0 / FACTOR < factor < FACTOR):
        return Fault(
            name, "columns", "the columns u and y",
            "u is what the model would make of y: exchange u and y in the mapping",
        )  # fmt: skip
    if alone and left < ALIKE and factor < 0:
        return Fault(
            name, "sign", "the sign of y",
            f"y is {factor:.3g} times what the model makes of u: flip y or u in the mapping, or the "
            "plant's gain",
        )  # fmt: skip
    if alone and left > ALIKE and _against(plant, u, y):
        return Fault(
            name, "sign", "the sign of y or u",
            "y moves against what the model makes of u, friction and drag aside: flip y or u in the "
            "mapping, or the plant's gain",
        )  # fmt: skip
    if alone and left > ALIKE and (beyond := _far_beyond(plant, u, y)):
        told = too_large(*beyond, but=", friction, drag and load aside")
        return Fault(name, "unit", "the unit of y or u, or the plant's gain", told)
    moderate = 1.0 / MODERATE < factor < MODERATE
    # The controller's equation holds: y has its unit, and so has u.
    most = ALIKE if alone or not moderate else LEAVES
    wrong = left < most and factor > 0 and not 1.0 / FACTOR < factor < FACTOR
    wrong = wrong and not _refuted(plant, recording, n, factor)
    if wrong and not (factor < 1.0 and _held_back(plant, u, y, left)):
        told = too_large(factor, left)
        beside, rest = _held_beside(plant, u, y, 1.0)
        off = beside > FACTOR if factor > 1.0 else 0.0 < beside < 1.0 / FACTOR
        if off and rest < BETTER * left:  # friction had its share in the factor
            told = too_large(beside, rest, ", friction and drag aside")
        return Fault(name, "unit", "the unit of y or u, or the plant's gain", told)
    return early(plant, recording) if alone else None


def _refuted(plant: Plant, recording: Recording, n: int, factor: float) -> bool:
    """Whether y follows r as no loop does whose plant has `factor` times the stated gain. (Magnets that
    push make of y a thousandth of what the model makes of u: the command holds them.)"""
    r, y = recording.r[:n] - recording.r[0], recording.y[:n] - recording.y[0]
    if plant.controller is None or not np.var(r - y) < UNALIKE * np.var(r):
        return False
    system = plant.system
    scaled: StateSpace | Zpk
    if isinstance(system, StateSpace):
        scaled = replace(system, c=factor * system.c, d=factor * system.d)
    else:
        scaled = replace(system, gain=factor * system.gain)
    with np.errstate(all="ignore"):
        made = Simulator(replace(plant, system=scaled)).run((), r, recording.f[:n]).y
        off = y - made
        share = float(np.var(off)) / max(float(np.var(y)), 1e-300)
    return not share < UNALIKE


def too_large(factor: float, left: float = 1e-4, but: str = "") -> str:
    """What to look at where y per u is `factor` times the model's, by more than a model is off, `but` for
    what; `left`: the share of y's variance that it leaves, which bounds the digits that are known. (Beside
    5 N of friction y in inches for metres was 23, 29 and 28 times the model's, and 39.5, 39.4 and 39.4
    times with the friction aside.)"""
    doubt = float(np.clip(np.sqrt(left), 1e-4, 1.0))
    digits = int(np.clip(np.floor(-np.log10(doubt)) + 1, 2, 4))
    known = looks_like(factor, float(np.clip(doubt, NEAR, UNSURE)))
    return (
        f"y is {'about ' * (digits < 3)}{factor:.{digits}g} times what the model makes of u{but}"
        + (f" ({known}?)" if known else "")
        + ": check the gain of the plant file and the units of y and u in the mapping"
    )


def _held_beside(
    plant: Plant, u: Array, y: Array, sign: float, hung: bool = False
) -> tuple[float, float]:
    """(k, share of y's variance that is left) of y = k G (sign u - forces that hold the machine back along
    the motion as measured, and all of the command where it stands, or with `hung` a constant one, each of
    any size)."""
    made, out = compared(plant, u, y)
    forces = [*moved_by(plant, y)[:HOLD], *held_by(plant, sign * u, y)]
    if hung:
        load = np.minimum(np.arange(len(u), dtype=float), 1.0)  # `compared` begins at zero
        forces += [load, -load]
    beside = np.column_stack([compared(plant, force, y, by=u)[0] for force in forces])
    whole = float(out @ out)
    if whole <= 0.0 or not np.all(np.isfinite(beside)):
        return 1.0, 1.0
    weights, left = _remains(np.column_stack([sign * made, -beside]), out, whole)
    return float(weights[0]), left


def _far_beyond(plant: Plant, u: Array, y: Array) -> tuple[float, float] | None:
    """(Factor by which y is larger than G u less forces that hold the machine back, or those and a load,
    share of y's variance that is left), where the factor is one that no model is off by: they never make
    it larger. (A y in mm for m: 1,010 times beside 7 N of dry friction, 1,010 beside 137 N that hang, 1,070
    beside both, 0.00002, 0.0001 and 0.02 of its variance left; a factor alone leaves 0.31 to 0.9. Of 317
    recordings without such a mistake none.)"""
    for hung in (False, True):
        factor, left = _held_beside(plant, u, y, 1.0, hung)
        if factor > MODERATE and left < TURNED:
            return factor, left
    return None


def _against(plant: Plant, u: Array, y: Array) -> bool:
    """Whether y is a factor of -G u less forces that hold the machine back along the motion as measured,
    and far from one of G u less such forces. (Of a crane whose friction takes 40 % of the command a factor
    leaves 0.44 and 0.56 of y's variance; with dry friction beside it, and with all of the command where it
    stands, 0.000 one way and all the other. Of 317 recordings without such a mistake none.)"""
    factor, turned = _held_beside(plant, u, y, -1.0)
    _, stated = _held_beside(plant, u, y, 1.0)
    return turned < TURNED and stated > UNALIKE and 1.0 / FACTOR < factor < FACTOR


def _held_back(plant: Plant, u: Array, y: Array, left: float) -> bool:
    """Whether y = G (u - what holds the machine back more, or less, than in proportion) says clearly more
    than a factor does, which leaves the share `left` of y's variance: friction, drag, a spring that hardens
    along the motion as measured, a limit of the command or a dead zone; these two also more than a factor
    beside the rest. (Drag of 160 v|v| N under water makes y a quarter of what G makes of u, but for 0.048
    of its variance; with drag 0.0001 is left. Beside a dead zone it is 0.046, and with both 0.00003. A
    controller that winds up behind its limit makes of y a thousandth. A wrong unit is the same at every
    amplitude.)"""
    size = np.abs(u)
    levels = [*np.quantile(size, LEVELS), *(size.max() * OF_LARGEST)]
    moved = [*moved_by(plant, y), *held_by(plant, u, y)]
    cut = [u - np.clip(u, -level, level) for level in levels]
    lost = [np.clip(u, -level, level) for level in size.max() * DEAD]
    made, out = compared(plant, u, y)
    columns = [compared(plant, force, y, by=u)[0] for force in [*moved, *cut, *lost]]
    whole = float(out @ out)
    if whole <= 0.0 or not np.all(np.isfinite(columns)):
        return False
    by_motion, limited, dead = np.split(
        np.column_stack(columns), [len(moved), len(moved) + len(cut)], axis=1
    )
    if _remains(by_motion, made - out, whole)[1] < BETTER * left:
        return True
    weights, beside = _remains(np.column_stack([made, -by_motion]), out, whole)
    if weights[0] > 1.0 / FACTOR:  # a factor beside the rest that a model may be off by
        if beside < BETTER * left:
            return True
        beside = left
    # One or the other: what is beyond a level and what is below it are all of u, at any factor.
    least = min(
        _remains(np.hstack([by_motion, bent]), made - out, whole)[1] for bent in (limited, dead)
    )
    return least < BETTER * min(left, beside)


def _remains(columns: Array, wanted: Array, whole: float) -> tuple[Array, float]:
    """Weights >= 0 of the sum of `columns` that is nearest to `wanted`, and what it leaves of that, of
    `whole`."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    weights, left = scipy.optimize.nnls(columns / scale, wanted)
    return weights / scale, left**2 / whole
