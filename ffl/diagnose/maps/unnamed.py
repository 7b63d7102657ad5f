"""Named or nameless: the catalogue's answer against the free maps, and what the winner depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ffl.diagnose.contest.earning import BOTH, LOST, UNTOLD
from ffl.diagnose.contest.scene import Scene, is_far
from ffl.diagnose.hypothesis.amounts import NAMES
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.depends import needed_variables
from ffl.diagnose.maps.dropouts import Dropouts, dropouts
from ffl.diagnose.maps.falling import falling_limits, law
from ffl.diagnose.maps.formula import Formula, formula
from ffl.diagnose.maps.freeform import FAR, FreeForm, calmed, free_form, held_gain
from ffl.diagnose.maps.freemodel import (
    FreeScreen,
    Part,
)
from ffl.diagnose.maps.gains import (
    MARGIN,
    as_good,
    cost_of,
    gains_of,
    in_own_noise,
    left_alone,
    nearly,
    with_the_stated_mass,
    within_the_line,
)
from ffl.diagnose.maps.known import HELD_WORTH, hardly_shown
from ffl.diagnose.maps.measured import measured
from ffl.diagnose.noise.doubt import judged_by
from ffl.diagnose.noise.imitate import Imitation, imitated
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.unrest import without_unrest
from ffl.diagnose.recorded.events import PLAINLY, Events, events
from ffl.effects import EFFECTS
from ffl.effects.periods import Repeating, harmonics
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

LATE = frozenset({"input_delay", "actuator_lag"})  # what commands that did not arrive pass for
SURE = 40.0  # of the fitted recordings, where the held-out ones lean that way (true names: 18)
QUIET_ENOUGH = 1.15  # mean square of a residual under the least noise below which nothing is left
EARNED = 0.05  # share of the mismatch that names must take off beside maps
MANY = 20  # draws of noise that bursts are held against before they are called events
LOUDER = 1.5  # times the bursts that noise alone makes in the machine as named: events beyond
TWICE = 2.0  # periods that the travel must hold before harmonics are those of what repeats
SHARED_OUT = 0.03  # of the events before that may remain beside an effect that explains them
HALF = 0.5  # of the mismatch that names must explain where bursts remain beside them
NEEDED = 0.03  # of a map's evidence that shuffling a variable must cost


@dataclass(frozen=True)
class Contest:
    """`alone`: maps in place of names (its `parts` empty where there are none); `beside`: maps on top
    of the names; `fitted`, `held_out`: what `alone` gains over the names; `events`: bursts in what
    maps in place of names leave, else in what the names leave. `verdict`: 'named', 'unnamed', 'partly'
    or 'nothing'."""

    verdict: str
    alone: FreeForm | None
    beside: FreeForm | None
    fitted: float
    held_out: float
    events: Events | None
    variables: tuple[str, ...] = ()
    needed: tuple[tuple[str, float], ...] = ()  # share of the evidence that each variable is worth
    formulas: tuple[Formula, ...] = ()
    lost: Dropouts | None = None  # commands that did not arrive: what is unnamed, in place of maps
    led: bool = False  # the map was seen along the motion as measured: free runs do not follow it

    @property
    def mapped(self) -> tuple[str, ...]:
        """Of the variables those of the maps."""
        own = () if self.winner is None else self.winner.variables
        return tuple(v for v in self.variables if v in own)

    @property
    def bursts_remain(self) -> bool:
        """What maps in place of names leave comes in bursts."""
        return self.verdict == "unnamed" and self.events is not None and self.events.found

    @property
    def winner(self) -> FreeForm | None:
        return self.alone if self.verdict == "unnamed" else self.beside


def compare(
    scene: Scene, held: Scene | None, nominal: Model, found: Fit, rng: Generator
) -> Contest:
    """The names that were `found` against maps alone, and beside maps."""
    standing = found.model
    named = bool(standing.effects)
    if scene.plain:  # no noise model to judge a map by
        return Contest("named" if named else "nothing", None, None, 0.0, 0.0, None)
    left, before = scene.residuals(standing), scene.residuals(nominal)
    if left is None or before is None:
        return Contest("named" if named else "nothing", None, None, 0.0, 0.0, None)
    if held is not None and held.trials:
        held = judged_by(held, found)
    calm, calm_held = without_unrest(scene), None if held is None else without_unrest(held)
    lost = dropouts(calm, calm_held, nominal)
    if lost is not None:
        gains = lost.gains(calm, calm_held, standing)
        if _lost(lost, *gains) and _over_a_delay(lost, gains, (calm, calm_held), standing):
            return Contest("unnamed", None, None, *gains, None, ("command", "time"), lost=lost)
    stated = None
    bursts, loud = events(scene, left), _loudness(scene, standing, left)
    if not bursts.found:
        stated = nominal.base.plant
        bursts = events(scene, left, stated)
    if bursts.found or (named and loud > QUIET_ENOUGH):
        # What sticks and slips answers noise in bursts, louder than the loop alone would make it; slow
        # noise holds few independent samples in a short window and looks like bursts on any machine.
        machine, sent = standing.judged_on(scene.trials)
        alike = imitated(machine.plant(), sent, scene.noise, rng)
        bursts = _beyond(bursts, scene, alike, stated)
        if bursts.found:  # a few draws may all be tame
            more = imitated(machine.plant(), sent, scene.noise, rng, MANY)
            bursts = _beyond(bursts, scene, more, stated)
        loud /= max([1.0, *(_loudness(scene, standing, one.y) for one in alike)])
    at_ease = loud < QUIET_ENOUGH and not bursts.found
    if named:  # what a limit leaves that should fall with speed may have been heard as noise
        falls = _falling(scene, held, standing, nominal)
        if falls is not None:
            return falls
    if bursts.found and named and _told(calm, standing, left, before) < HALF:
        named = False  # what stands drew some of the bursts, and they are still there
    maps = free_form(scene, held, _without_names(standing, nominal))
    bare = maps[0].free.model if maps else nominal
    alone = maps[-1] if maps and maps[-1].parts else None
    if alone is None or _astray(scene, standing, alone):
        drawn = _led(calm, calm_held, nominal, standing, left)
        if drawn is not None:
            gained = drawn.evidence
            return Contest("unnamed", drawn, None, gained, 0.0, None, drawn.variables, led=True)
    fitted, held_out, likely = (
        gains_of(scene, held, standing, nominal, alone) if alone else (0.0, 0.0, 0.0)
    )
    gains = fitted, held_out
    if not named:
        # Over numbers of the linear model that have converged; recordings that hardly show what the
        # maps are cannot confirm it.
        # A magnet that the judging move passes by: over a damping 38 times the stated one it was to show.
        unseen = gains[1] > -HELD_WORTH and hardly_shown(likely, gains[0])
        hardly = alone is not None and (alone.untold or unseen)
        told = gains[0] > MARGIN and (gains[1] > MARGIN or (hardly and gains[0] > UNTOLD))
        if alone and told and in_own_noise(scene, standing, alone) > MARGIN:
            said = _described(Contest("unnamed", alone, None, *gains, _after(alone)), scene, rng)
            if said.verdict == "unnamed":
                return said
        verdict = "unnamed" if bursts.found else "nothing"
        return Contest(verdict, None, None, 0.0, 0.0, bursts, ("time",) if bursts.found else ())
    # What was seen directly in the recording stands; maps may come beside it. (A clipped output under
    # loud noise has a rounder mean than its limit, and a map that draws it is no discovery.)
    seen = bool({e.name for e in standing.effects} & standing.proven)
    alone = None if seen else alone
    if alone and min(gains) > -MARGIN and _drawn(standing):
        return _described(Contest("unnamed", alone, None, *gains, _after(alone)), scene, rng)
    count = _beside_numbers(standing)
    several = count > len(alone.parts) if alone else False
    if alone and several and as_good(gains) and not _sum_of(standing, alone):
        # One thing where names need several: a sensor's curve is a gain by position and a drag.
        return _described(Contest("unnamed", alone, None, *gains, _after(alone)), scene, rng)
    winning = alone is not None and _ahead(gains)
    if alone and not winning and gains[0] > UNTOLD and -gains[1] < LOST * gains[0]:
        # Held-out recordings that show little of it may lose a little on a map, which is never
        # quite still where there is nothing.
        winning = cost_of(scene, standing, alone) > FAR * alone.cost
        # Where they can hardly tell names from maps the fitted ones do.
        winning = winning or likely < HELD_WORTH
    if at_ease and not winning:
        return Contest("named", alone, None, *gains, bursts)
    only = [p.term.name for p in alone.parts] if alone and winning else []
    maps = free_form(scene, held, standing, names=only)
    beside = maps[-1] if maps and maps[-1].parts else None
    if beside and not alone and not seen:
        alone = left_alone(beside, nominal)
        if alone:
            gains = gains_of(scene, held, standing, nominal, alone)[:2]
            winning = _ahead(gains)
    near = None  # several names that do less than one map are no simpler for being nearly right
    if alone and winning and count <= len(alone.parts):
        near = alone if nearly(scene, held, bare, standing, alone) else None
    if alone and winning and not near and not _better(beside, alone, nominal, held):
        return _described(Contest("unnamed", alone, beside, *gains, _after(alone)), scene, rng)
    if beside or near:
        return _described(Contest("partly", alone, beside or near, *gains, bursts), scene, rng)
    if bursts.found and bursts.excess > SHARED_OUT * events(scene, before, stated).excess:
        return Contest("partly", alone, None, *gains, bursts)
    return Contest("named", alone, None, *gains, bursts)


def _ahead(gains: tuple[float, float]) -> bool:
    """What hardly shows where it is judged, and is not spoken against there, must be the clearer."""
    told = gains[1] > HELD_WORTH or (gains[0] > SURE and gains[1] > 0.0)
    return gains[0] > MARGIN and told


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


def _beyond(bursts: Events, scene: Scene, alike: list[Imitation], stated: Plant | None) -> Events:
    """`bursts`, found only where they are louder than those of recordings `alike` in which noise is all."""
    usual = max((events(scene, one.y, stated).ratio for one in alike), default=0.0)
    return replace(bursts, limit=max(bursts.limit, LOUDER * usual))


def _loudness(scene: Scene, model: Model, residuals: list[Array]) -> float:
    """Mean square of residuals whitened by the least noise that they show."""
    quiet = replace(scene, noise=least_noise(scene, model, residuals))
    return float(np.mean(quiet.whiten(residuals) ** 2))


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


# --- what it depends on ---------------------------------------------------------------------------


def _described(contest: Contest, scene: Scene, rng: Generator) -> Contest:
    if contest.verdict == "unnamed" and contest.alone is not None:
        if within_the_line(scene, contest.alone):  # and the names it beats stand for no more
            return Contest("nothing", None, None, 0.0, 0.0, None)
        contest = replace(contest, alone=with_the_stated_mass(calmed(contest.alone)))
    winner = contest.winner
    assert winner is not None
    screen = FreeScreen(winner.scene, winner.free)
    needed: dict[str, float] = {}
    formulas = []
    for index, part in enumerate(winner.parts):
        for name, share in needed_variables(screen, winner.free, winner.white, part, rng).items():
            needed[name] = max(needed.get(name, 0.0), share)
        scale = winner.free.model.simulator.force_per_input if part.place.port == "force" else 1.0
        said = formula(screen, winner.free, winner.white, index, scale)
        if said is not None:
            formulas.append(said)
    worth = NEEDED + MARGIN / max(winner.evidence, MARGIN)
    variables = tuple(v for v in winner.variables if needed.get(v, 1.0) > worth)
    others = [v for part in winner.alike for v in part.term.variables]
    others += ["time"] if contest.bursts_remain else []
    variables = tuple(dict.fromkeys((*(variables or winner.variables), *others)))
    return replace(
        contest,
        variables=variables,
        needed=tuple(needed.items()),
        formulas=tuple(formulas),
    )


def component_of(parts: Sequence[Part]) -> str:
    """The component of the machine that a map's port points to."""
    part = parts[0]
    if part.place.port == "force":
        return "environment" if "heat" in part.term.along else "plant"
    return {"command": "actuator", "output": "sensor"}[part.place.port]
