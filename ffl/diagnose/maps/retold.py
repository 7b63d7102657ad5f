"""The same machine told otherwise: a map and the linear model's numbers that go with it.

A map of the speed and the damping beside it are one to any recording but for what is believed of the
damping; so are a map of the position and a stiffness, a map of the command and a mass. A formula is
sought beyond these numbers, and holds beside those that suit it: not beside the map's own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffl.diagnose.hypothesis.amounts import own_damping
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.choosing import NO_WORSE
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.freeform import judged
from ffl.diagnose.maps.freemodel import FreeModel, FreeScreen, Part, run_of
from ffl.diagnose.maps.freestep import ROUNDS, numbers_beside, stepped, traces
from ffl.diagnose.maps.mapped import BY_COMMAND
from ffl.systems.state_space import Array

ALIKE = 1.05  # times the squares: what the same machine told otherwise may leave
# Of these a map of a command is what a unit of it does beside 1.
GAINS_BY = ("position", "speed", "time")
# Maps that are a damper or a spring where they are straight, and the model's own numbers of that kind.
STRAIGHT = {"velocity": "damping", "position": "stiffness"}
# And where they are even.
EVEN = {f"inertia by {variable}": "mass" for variable in ("speed", "position", "time")}


def from_there(like: FreeForm, free: FreeModel) -> FreeForm | None:
    """`free` fitted on to the recordings of `like`; None where it leaves all bounds."""
    found = stepped(FreeScreen(like.scene, free), free, ROUNDS)
    if found is None:
        return None
    free, now, _ = found
    ended = judged(like.scene, like.held, free, like.evidence, now.white)
    return None if ended is None else replace(ended, ranking=like.ranking)


def own_number(alone: FreeForm) -> int | None:
    """Which of the model's free numbers the straight part of one map alone is, or the even part of an
    inertia; None where it is none."""
    wanted = ("correction", (STRAIGHT | EVEN).get(alone.parts[0].term.name))
    keys = [(c.kind, c.name) for c in alone.free.model.coordinates]
    return keys.index(wanted) if len(alone.parts) == 1 and wanted in keys else None


def _own_part(part: Part) -> Array:
    """Of the map, by its knots, what the model's own number does."""
    at = part.term.knots(part.ranges)
    return np.ones_like(at) if part.term.name in EVEN else at


def with_the_stated_mass(alone: FreeForm) -> FreeForm:
    """The same where one map of the command, or of what a unit of it does, stands beside a mass m times as
    far off as the map is steep: of a command that acts (u + g)/(1 + m) on a machine of the stated mass,
    with the other numbers taken back by as much. A straight part of the map and a mass are one to any
    recording. (A valve of 1 and 0.76 either way: 0.87 and 1.47 beside 120 % more mass.)"""
    free, mass = alone.free, alone.free.model.corrections.get("mass", 0.0)
    part, k = alone.parts[0], 1.0 + mass
    gain = part.term.driver == "command" and part.term.along in GAINS_BY
    itself = part.term.kind == BY_COMMAND
    if len(alone.parts) > 1 or not mass or not (gain or itself):
        return alone
    unit = part.term.knots(part.ranges) if itself else 1.0
    taken = replace(part, coefficients=(unit + part.coefficients) / k - unit)
    damping = own_damping(free.model)
    whole = {"mass": 1.0, "stiffness": 1.0, "damping": damping}
    numbers = {
        name: (whole[name] + value) / k - whole[name] if name in whole else value
        for name, value in free.model.corrections.items()
    }
    return _if_alike(alone, FreeModel(replace(free.model, corrections=numbers), (taken,)))


def with_the_stated_number(alone: FreeForm) -> FreeForm:
    """The same where one map of the speed, of the position, or of an inertia by either, stands beside a
    damping, a stiffness, or a mass, that is not the stated one: so much of it is the map's own."""
    free, at = alone.free, own_number(alone)
    now = None if at is None else run_of(alone.scene, free)
    if at is None or now is None or not free.model.theta[at]:
        return alone
    part, screen = alone.parts[0], FreeScreen(alone.scene, free)
    z = _own_part(part)
    line = traces(screen, free, now.motions)[0] @ z
    slope = (
        free.model.theta[at] * float(line @ screen.slopes[:, at]) / max(float(line @ line), 1e-300)
    )
    numbers = {**free.model.corrections, free.model.coordinates[at].name: 0.0}
    turned = replace(part, coefficients=part.coefficients + slope * z)
    return _if_alike(alone, FreeModel(replace(free.model, corrections=numbers), (turned,)))


def beside_formula(found: FreeForm, said: Formula, scale: float) -> FreeForm | None:
    """`found`, of one map, beside the numbers that suit the formula in its place; None where its straight
    part is no number of the model's, or the formula leaves much more than the map. `scale`: of the map to
    its unit. (A flywheel with an eddy brake: 1,530 % more damping, where its formula needed 1,095.)"""
    if own_number(found) is None or said.values is None:
        return None
    part = found.parts[0]
    drawn = replace(part, coefficients=said.values / scale)
    best = None
    for model in (found.free.model, found.free.model.at(0.0 * found.free.model.theta)):
        fitted = numbers_beside(found.scene, FreeModel(model, (drawn,)))
        if fitted is not None and (best is None or fitted[1].cost < best[1].cost):
            best = fitted
    if best is None or best[1].cost > NO_WORSE * found.cost:
        return None
    model = best[0].model
    now = run_of(found.scene, found.free)
    assert now is not None
    table = traces(FreeScreen(found.scene, found.free), found.free, now.motions)[0]
    weight, z = np.linalg.norm(table, axis=0), _own_part(part)
    apart = weight * (drawn.coefficients - part.coefficients)
    even = [] if part.term.name in EVEN else [np.ones(len(z))]
    line = np.column_stack([*even, z]) * weight[:, None]
    slope = np.linalg.lstsq(line, apart, rcond=1e-10)[0][-1]
    turned = replace(part, coefficients=part.coefficients + slope * z)
    for way in (turned, drawn):
        other = judged(found.scene, found.held, FreeModel(model, (way,)), found.evidence)
        if other is not None and _alike(other, found, ALIKE if way is turned else NO_WORSE):
            return replace(other, ranking=found.ranking, alike=found.alike, untold=found.untold)
    return None


def surprise(model: Model) -> float:
    """How far the numbers of the linear model are from the stated ones: sum of their squares, in units of
    what is believed of them."""
    return float(
        sum((t / c.doubt) ** 2 for t, c in zip(model.theta, model.coordinates, strict=True))
    )


def _if_alike(alone: FreeForm, free: FreeModel) -> FreeForm:
    """`alone` told as `free`, which is fitted on; as it is where that leaves more."""
    same = from_there(alone, free)
    if same is None or not _alike(same, alone, ALIKE):
        return alone
    return replace(same, alike=alone.alike, untold=alone.untold)


def _alike(other: FreeForm, found: FreeForm, most: float) -> bool:
    return other.cost <= most * found.cost and other.held_cost <= most * found.held_cost
