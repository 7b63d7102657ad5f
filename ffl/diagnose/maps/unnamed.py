"""Named or nameless: the catalogue's answer against the free maps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.earning import BOTH, LOST, UNTOLD
from ffl.diagnose.contest.scene import Scene, is_far
from ffl.diagnose.hypothesis.amounts import NAMES
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.bursts import Heard, heard_in
from ffl.diagnose.maps.choosing import FAR
from ffl.diagnose.maps.described import described
from ffl.diagnose.maps.dropouts import Dropouts, dropouts
from ffl.diagnose.maps.falling import falling_limits, law
from ffl.diagnose.maps.form import FreeForm, held_gain
from ffl.diagnose.maps.freeform import free_form
from ffl.diagnose.maps.gains import (
    EVEN,
    MARGIN,
    as_good,
    cost_of,
    elsewhere,
    gains_of,
    in_own_noise,
    left_alone,
    nearly,
)
from ffl.diagnose.maps.known import HELD_WORTH, hardly_shown
from ffl.diagnose.maps.measured import measured
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.noise.doubt import judged_by
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.unrest import without_unrest
from ffl.diagnose.recorded.events import PLAINLY, Events, events
from ffl.diagnose.recorded.repeating import repeating
from ffl.effects import EFFECTS
from ffl.effects.periods import Repeating, harmonics
from ffl.systems.state_space import Array

LATE = frozenset({"input_delay", "actuator_lag"})  # what commands that did not arrive pass for
SURE = 40.0  # of the fitted recordings, where the held-out ones lean that way (true names: 18)
EARNED = 0.05  # share of the mismatch that names must take off beside maps
TWICE = 2.0  # periods that the travel must hold before harmonics are those of what repeats
SHARED_OUT = 0.03  # of the events before that may remain beside an effect that explains them
NEARER = 0.8  # of the error beside a disturbance that comes again: what names must bring it to
MOST = 0.75  # of what maps were likely to gain held out: as good as may be hoped for
HALF = 0.5  # of the mismatch that names must explain where bursts remain beside them


@dataclass(frozen=True)
class Question:
    """The recordings, `calm` without what came over them before they began, the model alone and what
    stands by name, and what these leave: `before` and `left`."""

    scene: Scene
    held: Scene | None
    calm: Scene
    calm_held: Scene | None
    nominal: Model
    standing: Model
    before: list[Array]
    left: list[Array]

    @property
    def seen(self) -> bool:
        """Whether what stands was seen directly in the recording. (A clipped output under loud noise has a
        rounder mean than its limit, and a map that draws it is no discovery.)"""
        return bool({e.name for e in self.standing.effects} & self.standing.proven)


@dataclass(frozen=True)
class Gained:
    """What maps alone gain over the names: fitted, held out, and what they were likely to there."""

    fitted: float = 0.0
    held_out: float = 0.0
    likely: float = 0.0

    @property
    def both(self) -> tuple[float, float]:
        return self.fitted, self.held_out

    @property
    def ahead(self) -> bool:
        """What hardly shows where it is judged must be as good there as may be hoped for, or, where it is
        not spoken against, the clearer. (Of a bent scale 4.9 of 5.8, over a gain by position.)"""
        told = self.held_out > min(HELD_WORTH, max(EVEN, MOST * self.likely))
        told = told or (self.fitted > SURE and self.held_out > 0.0)
        return self.fitted > MARGIN and told


def compare(
    scene: Scene, held: Scene | None, nominal: Model, found: Fit, rng: Generator
) -> Contest:
    """The names that were `found` against maps alone, and beside maps."""
    standing = found.model
    named = bool(standing.effects)
    left = before = None
    if not scene.plain:  # else there is no noise model to judge a map by
        left, before = scene.residuals(standing), scene.residuals(nominal)
    if left is None or before is None:
        return Contest("named" if named else "nothing", None, None, 0.0, 0.0, None)
    if held is not None and held.trials:
        held = judged_by(held, _as_open(scene, nominal, found))
    calm, calm_held = without_unrest(scene), None if held is None else without_unrest(held)
    asked = Question(scene, held, calm, calm_held, nominal, standing, before, left)
    if told := _commands_lost(asked) or _comes_again(asked):
        return told
    heard = heard_in(scene, nominal, standing, left, rng)
    # What a limit leaves that should fall with speed may have been heard as noise.
    if named and (falls := _falling(scene, held, standing, nominal)):
        return falls
    if heard.bursts.found and named and _told(calm, standing, left, before) < HALF:
        named = False  # what stands drew some of the bursts, and they are still there
    maps = free_form(scene, held, _without_names(standing, nominal))
    alone = maps[-1] if maps and maps[-1].parts else None
    if alone is None or _astray(scene, standing, alone):
        drawn = _led(calm, calm_held, nominal, standing, left)
        if drawn is not None:
            gained = drawn.evidence
            return Contest("unnamed", drawn, None, gained, 0.0, None, drawn.variables, led=True)
    gains = Gained()
    if alone:
        gains = Gained(*gains_of(scene, held, standing, nominal, alone))
    if not named:
        return _or_nothing(asked, alone, gains, heard, rng)
    bare = maps[0].free.model if maps else nominal
    return _or_named(asked, bare, None if asked.seen else alone, gains, heard, rng)


def _as_open(scene: Scene, nominal: Model, found: Fit) -> Fit:
    """`found` with the numbers of the linear model free that maps are tried beside: those that it holds
    because the names need them no more are no better known for that. (A mode's frequency and damping, held
    where a scale curves: held out 2.2 times the noise, beside the right map too.)"""
    if found.model.held == nominal.held:
        return found
    return fit(scene, replace(found.model, held=nominal.held))


def _commands_lost(asked: Question) -> Contest | None:
    """Commands that did not arrive, where they say more than the names do."""
    calm, held, standing = asked.calm, asked.calm_held, asked.standing
    lost = dropouts(calm, held, asked.nominal)
    if lost is None:
        return None
    gains = lost.gains(calm, held, standing)
    if _lost(lost, *gains) and _over_a_delay(lost, gains, (calm, held), standing):
        return Contest("unnamed", None, None, *gains, None, ("command", "time"), lost=lost)
    return None


def _comes_again(asked: Question) -> Contest | None:
    """What is the same at the same time in every recording, beside the names if these leave clearly less
    of recordings that judge than the model alone does beside it."""
    scene, held, standing, nominal = asked.scene, asked.held, asked.standing, asked.nominal
    same = repeating(scene, held, standing)
    if same is None:
        return None
    alone = repeating(scene, held, nominal) if standing.effects else None
    beside = bool(standing.effects) and (alone is None or same.error < NEARER * alone.error)
    found, verdict = (same, "partly") if beside else (alone or same, "unnamed")
    gain = found.gain
    return Contest(verdict, None, None, gain, gain, None, ("time",), repeats=found)


def _or_nothing(
    asked: Question, alone: FreeForm | None, gains: Gained, heard: Heard, rng: Generator
) -> Contest:
    """Where no effect stands by name: maps, bursts or nothing. Maps are held over numbers of the linear
    model that have converged; recordings that hardly show what they are cannot confirm them. (A magnet
    that the judging move passes by: over a damping 38 times the stated one it was to show.)"""
    if alone:
        unseen = gains.held_out > -HELD_WORTH and hardly_shown(gains.likely, gains.held_out)
        hardly = alone.untold or unseen
        told = gains.held_out > MARGIN or (hardly and gains.fitted > UNTOLD)
        told = told and gains.fitted > MARGIN
        if told and in_own_noise(asked.scene, asked.standing, alone) > MARGIN:
            said = _unnamed(asked, alone, gains, rng)
            if said.verdict == "unnamed":
                return said
    found = heard.bursts.found
    when = ("time",) if found else ()
    return Contest("unnamed" if found else "nothing", None, None, 0.0, 0.0, heard.bursts, when)


def _or_named(
    asked: Question,
    bare: Model,
    alone: FreeForm | None,
    gains: Gained,
    heard: Heard,
    rng: Generator,
) -> Contest:
    """Where effects stand by name: these, maps in their place, or both. What was seen directly stands, maps
    come beside it; `bare`: the linear model that the maps were tried beside."""
    scene, held, nominal, standing = asked.scene, asked.held, asked.nominal, asked.standing
    bursts = heard.bursts
    if alone and _simpler(standing, alone, gains):
        return _unnamed(asked, alone, gains, rng)
    winning = alone is not None and _wins(scene, standing, alone, gains)
    as_well = elsewhere(standing, alone, gains.both)
    if heard.at_ease and not winning:
        return Contest("named", alone, None, *gains.both, bursts, elsewhere=as_well)
    only = [p.term.name for p in alone.parts] if alone and winning else []
    maps = free_form(scene, held, standing, names=only)
    beside = maps[-1] if maps and maps[-1].parts else None
    if beside and not alone and not asked.seen:
        alone = left_alone(beside, nominal)
        if alone:
            gains = Gained(*gains_of(scene, held, standing, nominal, alone))
            winning = gains.ahead
    near = None  # several names that do less than one map are no simpler for being nearly right
    if alone and winning and _beside_numbers(standing) <= len(alone.parts):
        near = alone if nearly(scene, held, bare, standing, alone) else None
    if alone and winning and not near and not _better(beside, alone, nominal, held):
        return _unnamed(asked, alone, gains, rng, beside)
    if beside or near:
        found = Contest("partly", alone, beside or near, *gains.both, bursts, instead=not beside)
        return described(found, scene, rng)
    shared = SHARED_OUT * events(scene, asked.before, heard.stated).excess if bursts.found else 0.0
    partly = bursts.found and bursts.excess > shared
    verdict = "partly" if partly else "named"
    return Contest(verdict, alone, None, *gains.both, bursts, elsewhere=as_well)


def _unnamed(
    asked: Question, alone: FreeForm, gains: Gained, rng: Generator, beside: FreeForm | None = None
) -> Contest:
    """Maps alone are the answer, with what they depend on."""
    contest = Contest("unnamed", alone, beside, *gains.both, _after(alone))
    return described(contest, asked.scene, rng)


def _simpler(standing: Model, alone: FreeForm, gains: Gained) -> bool:
    """Maps that do as well say less than the names: a period that nobody saw repeat, or one thing where
    names need several. (A sensor's curve is a gain by position and a drag.)"""
    if min(gains.both) > -MARGIN and _drawn(standing):
        return True
    several = _beside_numbers(standing) > len(alone.parts)
    return several and as_good(gains.both) and not _sum_of(standing, alone)


def _wins(scene: Scene, standing: Model, alone: FreeForm, gains: Gained) -> bool:
    """Maps say more than the names. Held-out recordings that show little of one may lose a little on it,
    which is never quite still where there is nothing; where they can hardly tell names from maps the
    fitted ones do."""
    if gains.ahead:
        return True
    if not (gains.fitted > UNTOLD and -gains.held_out < LOST * gains.fitted):
        return False
    return cost_of(scene, standing, alone) > FAR * alone.cost or gains.likely < HELD_WORTH


def _beside_numbers(standing: Model) -> int:
    """Effects that stand, but for those that are the linear model's own numbers beyond the line: the model
    beside a map has these free. (A spring off the middle and 5.5 % more mass are not two for a map.)"""
    own = {NAMES.get(c.name) for c in standing.base.corrections}
    return sum(name not in own for name in standing.names)


def _sum_of(standing: Model, alone: FreeForm) -> bool:
    """The maps hold whatever the names are: a force by position a spring and a load."""
    names = {variable for e in standing.effects for variable in EFFECTS[e.name].depends_on}
    return names <= set(alone.variables)


def _astray(scene: Scene, standing: Model, alone: FreeForm) -> bool:
    """Neither the names nor the maps run where the machine ran."""
    n = len(alone.white)
    return is_far(alone.cost, n) and is_far(cost_of(scene, standing, alone), n)


def _led(
    calm: Scene, held: Scene | None, nominal: Model, standing: Model, left: list[Array]
) -> FreeForm | None:
    """`measured` beside what stands; what names leave passes for noise in their own scene: near is who
    leaves the least noise there is. Numbers of a linear model that is far off are bent to stand for what
    is missing: then it is asked beside the nominal one."""
    quiet = replace(calm, noise=least_noise(calm, standing, left))
    found = fit(quiet, standing, rounds=0)
    if found.far and not standing.effects:
        found = fit(quiet, nominal, rounds=0)
    return measured(calm, held, found)


def _falling(scene: Scene, held: Scene | None, standing: Model, nominal: Model) -> Contest | None:
    """A limit that falls with speed, where it says more than a fixed one that is named; names beside it
    must bring what a further effect must."""
    best: tuple[FreeForm, float, float] | None = None
    for one in falling_limits(scene, held, standing, nominal):
        fitted, held_out, _ = gains_of(scene, held, standing, nominal, one)
        if best is None or fitted > best[1] + MARGIN:
            best = one, fitted, held_out
    if best is None or min(best[1:]) < MARGIN:
        return None
    one, gains = best[0], best[1:]
    return Contest("unnamed", one, None, *gains, None, one.variables, formulas=(law(one.free),))


def _lost(lost: Dropouts, fitted: float, held_out: float) -> bool:
    """What did not arrive says more than the names do, which samples it was charged; fitted recordings
    that hardly show it may lose a little where the others confirm it clearly."""
    if lost.confirmed:
        return held_out > MARGIN and fitted > MARGIN - BOTH * held_out
    return fitted > MARGIN and held_out > -MARGIN


def _over_a_delay(
    lost: Dropouts, gains: tuple[float, float], grounds: tuple[Scene, Scene | None], standing: Model
) -> bool:
    """What did not arrive gains more than a delay or lag which stands brings, in the fitted recordings or,
    where the others confirm it, in all together. As many samples late as there are lost in the mean, a
    delay is the smaller part of what they do where fewer than half are lost (p to 1 - p); where nothing
    is lost, samples chosen one by one draw a part of what the delay does and fit to noise."""
    late = [k for k, spec in enumerate(standing.effects) if spec.name in LATE]
    if not late:
        return gains[0] > 0.0
    bare = standing
    for k in reversed(late):
        bare = bare.without(k)
    scene, held = (None if g is None else g.like(lost.fitted.scene) for g in grounds)
    assert scene is not None
    without = fit(scene, bare)
    brought = 0.5 * (without.cost - scene.cost(standing))
    if gains[0] > brought:
        return True
    if not lost.confirmed or held is None:
        return False
    some, none = held.residuals(standing), held.residuals(without.model)
    if some is None or none is None:
        return False
    known = np.ones(len(lost.held_white), bool)
    brought += held_gain(held.judge(none), held.judge(some), known)
    return sum(gains) > brought


def _drawn(standing: Model) -> bool:
    """A period with harmonics that no recording holds twice draws any function of the position: nothing
    shows that it repeats, and a map that does as well says no more than was seen."""
    return any(
        isinstance(EFFECTS[e.name], Repeating)
        and len(harmonics(e.parameters)) > 1
        and TWICE * float(e.parameters["period"]) > standing.base.travel
        for e in standing.effects
    )


def _after(alone: FreeForm) -> Events | None:
    """Bursts in what the maps leave: they come at times of their own, whatever a map has drawn of them.
    No map is perfect, so they must be plain to see (a creep's left 3, knocks 16)."""
    left = alone.scene.residuals(alone.free)
    return None if left is None else replace(events(alone.scene, left), limit=PLAINLY)


def _without_names(standing: Model, nominal: Model) -> Model:
    """What maps are tried beside: a number held on the line, for no name to hide in it, hides a map just
    as well."""
    return nominal if standing.effects else replace(standing, held=nominal.held)


def _told(scene: Scene, standing: Model, left: list[Array], before: list[Array]) -> float:
    """Share of the mismatch `before` that `standing` explains, under the least noise that is left."""
    quiet = replace(scene, noise=least_noise(scene, standing, left))
    some, whole = (float(np.sum(quiet.whiten(e) ** 2)) for e in (left, before))
    return 1.0 - some / whole


def _better(beside: FreeForm | None, alone: FreeForm, nominal: Model, held: Scene | None) -> bool:
    """The names earn their place beside maps: without them a share of the mismatch comes back, in the
    fitted and in the held-out recordings."""
    if beside is None:
        return False
    pairs = [(beside.scene, alone.scene, beside.white, np.ones(len(beside.white), bool))]
    if held is not None and held.trials:
        judged, own = held.like(beside.scene), alone.held or held
        pairs.append((judged, own, beside.held_white, alone.known & beside.known))
    for scene, own, white, known in pairs:
        without = own.residuals(alone.free)
        nothing = scene.residuals(nominal)
        if without is None or nothing is None:
            return True
        if not known.any():
            continue
        if held_gain(scene.judge(without, known), white, known) < MARGIN:
            return False
        whole, some, none = (
            float(np.mean(x[known] ** 2))
            for x in (scene.judge(nothing, known), scene.judge(without, known), white)
        )
        if some - none < EARNED * (whole - none):
            return False
    return True
