"""Forms of dry friction whose further numbers say nothing: plain friction by another name, or a spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.dry import BY_DIRECTION, FALLING, plain_form
from ffl.diagnose.contest.evenly import TIE
from ffl.diagnose.contest.judging import Judged, judge, levelled, raw_error
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import NAMES
from ffl.diagnose.hypothesis.friction_table import NAME as TABLE
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import placed
from ffl.diagnose.noise.spread import error_of
from ffl.diagnose.recorded.trials import Trial
from ffl.effects.hysteresis import KINDS
from ffl.systems.plant import EffectSpec

CONTACT = "presliding_friction"
LOOP = "hysteresis"
# Of the sensor's noise: a way that no recording shows, and where the stiffness is unsure as well.
FREE, LED = (0.1, 0.4), (0.5, 2.0)  # in free runs and led by an observer
UNSURE = 0.4  # of a stiffness, or of a velocity: its standard error
EASED = 1.25  # times the held-out squares that plain friction may leave in its place
HOLDING = frozenset(
    {"constant_load", "linear_stiffness", "drift", "gravity_torque", "preloaded_spring"}
)
LEVELS = {  # the two that a form of dry friction has, where plain friction has one
    FALLING: ("static_level", "coulomb_level"),
    BY_DIRECTION: ("level_positive", "level_negative"),
}
SPRING = "stiffness"  # the model's own, which a straight line of forces by position is
FLAT = 0.02  # of the mean level: what lies between the levels of a table that has but one


def plainest(held: Scene | None, judged: Judged, outcome: Outcome) -> tuple[Judged, Outcome]:
    """(`judged` or the same with plain dry friction, `outcome` with both as contenders) where both levels
    of a friction have come together to within two standard errors: what told them apart went into other
    numbers since. (A robot's axis: 104.7 N m at standstill and 104.7 +- 110 in motion, beside a mass that
    had crossed the line.) A contact that gives way over less than any sensor shows eases what rounding
    makes of standstill, or the jumps of an observer's corrections of the state, and is none of the
    machine's; nor is a fall over a velocity that no recording shows, nor are places told by levels that
    differ by a hundredth, or by a spring's straight line, nor directions by what another force holds. (An
    extruder's 3 N, between 2.984 and 3.025.) Plain friction may have the numbers that were fitted beside
    them; of a table whose levels either way are the same everywhere it has one for each direction."""
    model = judged.model
    index = next((k for k, name in enumerate(model.names) if name in SAME), None)
    if index is None or judged.predicted:
        return judged, outcome
    spec = model.effects[index]
    eased = spec.name not in LEVELS or not _one_level(judged, index)
    eased = eased or (spec.name == BY_DIRECTION and _held(judged.model, index))
    eased = eased or "backlash" in model.names  # around a play no two fits end at the same numbers
    near = eased or (spec.name == FALLING and _falls_nowhere(judged, index))
    if not SAME[spec.name](judged, index):
        return judged, outcome
    plain = _plain(model, index, judged.scene.trials)
    line = {SPRING} if spec.name == TABLE and NAMES[SPRING] not in model.names else set()
    again = judge(judged.scene, held, model, 4, judged.fit)  # by the same noise
    effects = tuple(plain if k == index else e for k, e in enumerate(model.effects))
    plainer = replace(model, effects=effects, held=model.held - line)  # which the table held
    forms = [judge(judged.scene, held, plainer, rounds) for rounds in (8, 0)]
    if near:
        tried = min(forms, key=lambda form: raw_error(held, form.model))
    else:
        tried = max(levelled(forms), key=lambda form: form.score)
    others = [
        p for p in outcome.contenders.get(spec.name, ()) if p[0] not in (plain.name, spec.name)
    ]
    tried, again, *rest = levelled([tried, again, *(other for _, other in others)])
    if near:
        refused = raw_error(held, tried.model) > EASED * raw_error(held, judged.model)
    else:
        refused = not tried.score > again.score - TIE
    if refused:
        return judged, outcome
    names = [plain.name, spec.name, *(name for name, _ in others)]
    pairs = list(zip(names, [tried, again, *rest], strict=True))
    pairs = [pair for pair in pairs if not (eased and pair[0] == spec.name)]
    return tried, replace(outcome, contenders={**outcome.contenders, plain.name: pairs})


def _plain(model: Model, index: int, trials: Sequence[Trial]) -> EffectSpec:
    """Plain friction in the place of effect `index`: one level, or those of a table either way where no
    other effect can hold what they differ by. A spring in that of a loop."""
    spec = model.effects[index]
    if spec.name == LOOP:
        rate = float(spec.parameters["force"]) / float(spec.parameters["displacement"])
        # It begins where the machine stands, between a push either way.
        centre = float(np.mean(np.concatenate([t.y[:1] for t in trials])))
        options = placed(spec)
        return EffectSpec(NAMES[SPRING], {SPRING: rate, "centre": centre}, options)
    plain = plain_form(spec)
    assert plain is not None
    if spec.name != TABLE or HOLDING & set(model.names):
        return plain
    either = in_the_mean(spec)
    if either is spec:  # no table yet
        return plain
    up, down = (float(either.parameters[name]) for name in LEVELS[BY_DIRECTION])
    return plain if abs(up - down) < FLAT * (up + down) else either


def in_the_mean(spec: EffectSpec) -> EffectSpec:
    """A table by position as its mean either way. Others as they are. (To begin with that is the form: a
    play was looked for through the 18 numbers of a table for 6 minutes.)"""
    table = spec.parameters.get("table")
    if spec.name != TABLE or not isinstance(table, Mapping):
        return spec
    levels = {f"level_{way}": float(np.mean(table[way])) for way in ("positive", "negative")}
    return EffectSpec(BY_DIRECTION, levels, placed(spec))


def _one_level(judged: Judged, index: int) -> bool:
    spec = judged.model.effects[index]
    one, other = LEVELS[spec.name]
    apart = abs(float(spec.parameters[one]) - float(spec.parameters[other]))
    errors = [error_of(judged, index, name) or 0.0 for name in (one, other)]
    return apart < 2.0 * float(np.hypot(errors[0], errors[1]))


def _held(model: Model, index: int) -> bool:
    """Whether levels either way are within some hundredths beside another force, which holds what they
    differ by. (Beside a drift that was 3 % off, 3.127 and 3.096 N for 3.12.)"""
    up, down = (float(model.effects[index].parameters[name]) for name in LEVELS[BY_DIRECTION])
    return abs(up - down) < FLAT * (up + down) and bool(HOLDING & set(model.names))


def unseen(judged: Judged, index: int) -> bool:
    """Whether the contact of effect `index`, presliding friction, gives way over less than sensors show."""
    values = judged.model.effects[index].parameters
    stiffness, noise = float(values["stiffness"]), judged.scene.noise.sensor
    way = float(values["level"]) / stiffness
    unsure = (error_of(judged, index, "stiffness") or 0.0) > UNSURE * stiffness
    return way < (LED if judged.scene.observed else FREE)[unsure] * noise


def _flat(judged: Judged, index: int) -> bool:
    """Whether a table of friction has the same level at all places, to a hundredth, but for a load or a
    spring: what its levels either way differ by is a straight line over the position."""
    table = judged.model.effects[index].parameters.get("table")
    if not isinstance(table, Mapping):
        return True
    grid, up, down = (np.asarray(table[key], float) for key in ("grid", "positive", "negative"))
    level, apart = 0.5 * (up + down), 0.5 * (up - down)
    line = np.column_stack([np.ones_like(grid), (grid - grid.mean()) / np.ptp(grid)])
    bent = apart - line @ np.linalg.lstsq(line, apart, rcond=None)[0]
    return max(float(np.ptp(level)), float(np.ptp(bent))) < FLAT * abs(float(level.mean()))


def _told_nowhere(judged: Judged, index: int) -> bool:
    """Whether the levels of a Stribeck curve are one, or it falls nowhere."""
    return _falls_nowhere(judged, index) or _one_level(judged, index)


def _falls_nowhere(judged: Judged, index: int) -> bool:
    """Whether the velocity over which a Stribeck curve falls is less sure than large, or unsure and in
    a sample less than the sensor's noise. (Two more numbers took up what rounds of a fit had left: 0.589 N,
    and 0.552 +- 95 over 94 +- 1,360 mm/s, for 0.646; on a scale of 0.5 um, read every ms, 0.300 V that rise
    to 0.418 below 0.44 +- 0.2 um/s.)"""
    velocity = float(judged.model.effects[index].parameters["stribeck_velocity"])
    error = error_of(judged, index, "stribeck_velocity") or 0.0
    noise = judged.scene.noise.sensor / judged.model.base.plant.sample_time
    return error > velocity or (error > UNSURE * velocity and velocity < noise)


def _never_slides(judged: Judged, index: int) -> bool:
    """Whether a hysteresis is a spring: it would slide over more than the machine travelled, or slide or
    harden over nobody knows what, and its force is as unsure. (A spring of 0.086 N/m was one that hardens
    over 0.29 m, of 0.2 that were travelled, its force 0.024 +- 0.083 N.)"""
    model, spec = judged.model, judged.model.effects[index]
    way, force = float(spec.parameters["displacement"]), float(spec.parameters["force"])
    unsure = (error_of(judged, index, "displacement") or 0.0) > way
    unsure = unsure and (error_of(judged, index, "force") or 0.0) > force
    beyond = spec.options.get("kind") != KINDS[1] and way > model.base.travel
    return (beyond or unsure) and NAMES[SPRING] not in model.names


SAME = {  # forms of dry friction, and when each is plain friction, or a spring, by another name
    FALLING: _told_nowhere,
    BY_DIRECTION: lambda judged, k: _held(judged.model, k) or _one_level(judged, k),
    CONTACT: unseen,
    TABLE: _flat,
    LOOP: _never_slides,
}
