"""The contest: every effect at every place against every other, judged by likelihood.

Each hypothesis is fitted with the noise it leaves itself (so that neither coloured noise passes for
physics nor physics for coloured noise), and scored by
    log-likelihood of the fitted recordings - penalty per free number + log-likelihood of the
    held-out recordings,
the second a free-running simulation with nothing fitted to it. One effect is added at a time; before
a second one is thought of, all siblings of the first have been fitted too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ffl.diagnose.contest.behind import behind_its_mode
from ffl.diagnose.contest.curves import two_for_two
from ffl.diagnose.contest.dry import DRY, PLIABLE, excluded
from ffl.diagnose.contest.earning import UNTOLD, earns, gaining
from ffl.diagnose.contest.forks import forks, within_the_travel
from ffl.diagnose.contest.hearing import in_its_noise, quieter
from ffl.diagnose.contest.judging import (
    Judged,
    credible,
    granted,
    judge,
    levelled,
    noise_error,
    raw_error,
    whitened_alike,
)
from ffl.diagnose.contest.lags import plain_lags
from ffl.diagnose.contest.line import claimants, crosses
from ffl.diagnose.contest.modes import mode_elsewhere
from ffl.diagnose.contest.overcome import overcome
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.restraint import as_far_as_told, spoken_against, worse
from ffl.diagnose.contest.rounds import Outcome, Step, to_the_end
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP, SUBSTITUTE, one_for_two, settle
from ffl.diagnose.contest.shares import shares_off
from ffl.diagnose.contest.stated import begun_as_stated, in_their_place
from ffl.diagnose.contest.stead import in_their_stead
from ffl.diagnose.contest.teeth import other_teeth
from ffl.diagnose.contest.timing import begun_late
from ffl.diagnose.contest.together import ENOUGH, HIDDEN, starts, together
from ffl.diagnose.contest.untabled import untabled
from ffl.diagnose.hypothesis.contact import with_other_contact
from ffl.diagnose.hypothesis.course import courses
from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.friction_table import no_patch, refined
from ffl.diagnose.hypothesis.harmonics import with_harmonics
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.heard import on_its_spring
from ffl.diagnose.noise.unrest import louder_than_noise
from ffl.diagnose.screen.glimpse import promising
from ffl.diagnose.screen.views import View, entrants_of, screens

FAINT = 16.0  # first-order gain below which a fit is not worth while
ROUNDS = 2  # per effect that may join, those counted in which none does or one is turned down
HALF = 0.5  # of the held-out sum of squares: less is left by no chance
CLOSER = 0.75  # of it: what who is refused must leave to be followed where the rest may be noise
MOST, MOST_OF_STAGES = 3, 5  # effects that may join; a row of lags has as many of its own
LOUD = 2.0  # times the held-out sum of squares of least noise: so much left, and one more may join


def contest(
    scene: Scene,
    held: Scene | None,
    model: Model,
    threshold: float,
    most: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Outcome:
    """Forward selection with substitution; the most pliable effects come in when no other does. Where
    something is left that nobody may explain, it goes on beside the near rivals of those who stand
    as well: who comes second by a little may be half of what comes first by far. So may who was turned
    down: alone it costs held-out recordings something that the others make good."""
    say = progress or (lambda line: None)
    most = _room(model) if most is None else most
    standing = judge(scene, held, model)
    steps = _beyond_any_noise(scene, held, standing, most, threshold, say)
    if steps and (last := steps[-1].accepted) is not None:
        standing = last
        scene, held = replace(scene, trials=standing.scene.trials), standing.held
    outcome = _climb(scene, held, standing, steps, {}, frozenset(), threshold, most, say)
    for name, rival in forks(outcome):
        if scene.work.done:
            break
        say(f"the other way: {rival.name}, without {name}")
        steps = [step for step in outcome.steps if step.accepted is not None]
        start = rival.scene, rival.held, rival, steps, outcome.contenders
        other = _climb(*start, frozenset({name}), threshold, most, say)
        if _ahead(other, outcome, say):
            return other
    outcome = _with_who_was_turned_down(outcome, threshold, most, say)
    ways = (
        partial(in_their_stead, outcome.steps),
        on_its_spring,
        behind_its_mode,
        two_for_two,
        overcome,
        untabled,
        within_the_travel,
        begun_late,
        mode_elsewhere,
        shares_off,
    )
    for other_way in ways:
        pair = other_way(outcome.standing.scene, outcome.held, outcome.standing, say)
        if pair is None:
            continue
        say(f"the other way: {pair.name}")
        other = Outcome(pair, outcome.steps, pair.held, {})
        if not scene.work.done:  # found so late it is taken as it is
            start = pair.scene, pair.held, pair, outcome.steps, {}
            other = _climb(*start, frozenset(), threshold, most, say)
        alike = set(pair.model.names) == set(other.standing.model.names)
        # Noise has spoken; and a correction needs no lead over an effect.
        told = other_way is on_its_spring or (other_way is shares_off and alike)
        outcome = other if told or _ahead(other, outcome, say) else outcome
    return outcome


def _ahead(other: Outcome, outcome: Outcome, say: Callable[[str], None]) -> bool:
    """Whether what `other` came to is likelier, and no worse on the held-out recordings."""
    ahead, behind = whitened_alike([other.standing, outcome.standing])
    say(f"  {ahead.name} for {behind.name}: {ahead.score - behind.score:+.1f}")
    left = raw_error(other.held, ahead.model), raw_error(outcome.held, behind.model)
    better = ahead.score > behind.score + SUBSTITUTE
    return better and not worse(other.held, ahead, behind, *left)


def go_on(
    scene: Scene, held: Scene | None, standing: Judged, threshold: float, say: Callable[[str], None]
) -> Outcome:
    """The contest from `standing` on, found otherwise."""
    return _climb(scene, held, standing, [], {}, frozenset(), threshold, _room(standing.model), say)


def _room(model: Model) -> int:
    """How many effects may join."""
    return MOST_OF_STAGES if model.base.is_process else MOST


def _with_who_was_turned_down(
    outcome: Outcome, threshold: float, most: int, say: Callable[[str], None]
) -> Outcome:
    """Where the first that was refused brought the fitted recordings very much, it goes on from there with
    nobody turned down; what it comes to stands only if it leaves less than `HALF` of what was left in
    the held-out recordings, with credible numbers. All misfit passes for noise where nobody stands: who
    leaves less of them, or explains them by very much, is followed then too. (Stribeck friction, drag and
    a spring: the friction alone cost 1.1 times the held-out error, all three leave a ninetieth. A limit,
    beside a damping of 57 times the model's for a drag, left half of the squares, and with the drag a
    ninetieth.)"""
    stood = raw_error(outcome.held, outcome.standing.model)
    scene = outcome.standing.scene
    if scene.work.done:
        return outcome
    noisy = HALF * stood < noise_error(outcome.held, scene)
    for step in outcome.steps:
        one = step.refused
        if one is None or one.fitted - step.before.fitted < UNTOLD:
            continue
        told = one.held_out - step.before.held_out > UNTOLD
        if noisy and not told and not raw_error(outcome.held, one.model) < CLOSER * stood:
            continue  # what is left may be noise
        say(f"the other way: with {one.name}, refused before")
        joined = [s for s in outcome.steps[: outcome.steps.index(step)] if s.accepted is not None]
        steps = [*joined, replace(step, accepted=one, turned_down=None)]
        other = _climb(
            one.scene, one.held, one, steps, {}, frozenset(), threshold, most, say, patient=True
        )
        left = raw_error(other.held, other.standing.model)
        say(f"  {np.sqrt(left / stood):.2f} times the held-out error")
        return other if left < HALF * stood and credible(other.standing) else outcome
    return outcome


def _climb(
    scene: Scene,
    held: Scene | None,
    standing: Judged,
    steps: list[Step],
    contenders: dict[str, list[tuple[str, Judged]]],
    barred: frozenset[str],
    threshold: float,
    most: int,
    say: Callable[[str], None],
    patient: bool = False,
) -> Outcome:
    """From `standing`, reached by `steps`, up to where nobody else earns a place; who is `barred` takes
    the place of none before another has joined. `patient`: nobody is turned down again."""
    last_error = np.inf
    reserve = PLIABLE
    told: tuple[str, ...] | None = None  # company beside which all but the pliable had their say
    turned_down: set[str] = set()  # in the present company
    again, at_once, anew, heard = False, True, True, False
    quiet, base = scene, standing
    while True:
        if anew:
            quiet, held = in_its_noise(replace(scene, loop=standing.fit.loop), held, standing)
            scene = replace(scene, loop=quiet.loop, trials=quiet.trials)
            base = judge(quiet, held, standing.model, rounds=6)
            say(f"{base.name}: log-likelihood {base.fitted:.1f}, held out {base.held_out:.1f}")
            base = with_harmonics(quiet, held, refined(quiet, held, base, say), say)
            if not again:
                base = with_other_contact(quiet, held, base, say)
            base = plain_lags(quiet, held, base, say)
        last_contenders = contenders
        if base.model.effects:
            base, contenders = settle(
                quiet, held, base, steps, reserve | barred, say, last_contenders if again else {}
            )
            one = base if again else one_for_two(quiet, held, base, say)
            if one is not base:
                contenders = {k: v for k, v in contenders.items() if k in one.model.names}
                base = one
        if not anew and base.model.effects and base.model.names == standing.model.names:
            return Outcome(base, steps, held, contenders)
        if not heard and base.model.names != standing.model.names and quieter(quiet, base):
            say(f"{base.name}: the noise is heard anew")
            standing, heard, anew = base, True, True
            continue
        error = raw_error(held, base.model)
        last = steps[-1].before if steps and not (again or patient) else None
        kept = (
            (base, error) if last is None else as_far_as_told(held, base, last, error, last_error)
        )
        if kept is None:
            assert last is not None  # who would be kept else
            # What came in last does not hold up on the held-out recordings once all is refitted.
            times = np.sqrt(error / last_error)
            say(f"  turned down again: held-out error {times:.2f} times as large")
            came = steps[-1].joined
            turned_down |= set(came) if len(came) == 1 else set()
            at_once = at_once and len(came) == 1
            steps[-1] = replace(steps[-1], accepted=None, turned_down=steps[-1].accepted)
            standing, contenders, again, anew = last, last_contenders, True, True
            scene = replace(scene, trials=standing.scene.trials)
            held = standing.held
            continue
        base, error = kept
        if not again:  # who came in and left again need not come a second time
            back = bool(steps) and steps[-1].before.model.names == base.model.names
            turned_down = set(steps[-1].joined) if back else set()
        last_error = error
        joined = min(sum(len(step.joined) for step in steps), len(base.model.effects))
        accepted = None
        more = most + (error > LOUD * noise_error(held, quiet))
        if joined < more and len(steps) < ROUNDS * more and not scene.work.done:
            taken = excluded(base.model) | turned_down
            # What hides in the noise of the first round may be faint.
            least = FAINT if steps else FAINT / 2
            # Company that has changed since the others had their say gives everyone another.
            pliable = None if told not in (None, base.model.names) else not reserve
            views = [View.of(s, taken, least, pliable) for s in screens(quiet, base)]
            room = max(most - joined, 0) if at_once else 0
            steps.append(_round(quiet, held, base, views, taken, room, threshold, say))
            base, accepted = steps[-1].before, steps[-1].accepted
        if accepted is None and reserve and (base.fit.far or _rubs(base, steps)):
            # The same company once more, with those in it that were kept back.
            reserve, standing, last_error, again = frozenset(), base, np.inf, True
            anew = base.fit.far  # those kept back may join as well
            told = base.model.names
            continue
        if accepted is None:
            return Outcome(base, steps, held, contenders)
        standing, again, anew, heard, barred = accepted, False, True, False, frozenset()
        scene = replace(scene, trials=accepted.scene.trials)  # with the clocks it settled on
        held = accepted.held


def _rubs(base: Judged, steps: Sequence[Step]) -> bool:
    """Dry friction stands, or, where nothing does, would take very much off the fitted recordings alone."""
    if base.model.effects:
        return bool(set(base.model.names) & DRY)
    dry = [r for step in steps[-1:] for r in step.rivals if r.model.names[-1] in DRY]
    return any(r.fitted - base.fitted > UNTOLD for r in dry)


def _beyond_any_noise(
    scene: Scene,
    held: Scene | None,
    standing: Judged,
    most: int,
    threshold: float,
    say: Callable[[str], None],
) -> list[Step]:
    """Several effects that come in at once where no noise is stated, and so all that is left may pass for
    it: they are looked for under the loudest noise there can be, and others for as long as more is left. (A
    robot's joint with gravity and friction left out shook by 20 % of its command to all appearance.)"""
    if scene.guess is None:
        return []
    capped = replace(scene, loudest=scene.guess, loop=standing.fit.loop)
    quiet, held = in_its_noise(capped, held, standing)
    base = judge(quiet, held, standing.model, rounds=6)
    if not base.fit.far:
        return []
    views = [View.of(s, excluded(base.model), FAINT / 2, False) for s in screens(quiet, base)]
    found = starts(base, [(v.screen, v.allowed) for v in views], most)
    several = together(quiet, held, base, found, threshold, say) if found else None
    if several is None or several.fitted < base.fitted + threshold:
        return []
    steps = [Step(base, tuple(c for v in views for c in v.seen), (several,), several)]
    while several.fit.far and len(several.model.effects) < most:
        taken = excluded(several.model)
        views = [View.of(s, taken, FAINT, None) for s in screens(quiet, several)]
        step = _round(quiet, held, several, views, taken, 1, threshold, say)
        if step.accepted is None:
            break
        steps, several = [*steps, step], step.accepted
    free = replace(several, scene=replace(several.scene, loudest=None))
    return [*steps[:-1], replace(steps[-1], accepted=free)]


def _round(
    quiet: Scene,
    held: Scene | None,
    base: Judged,
    views: Sequence[View],
    taken: Collection[str],
    room: int,
    threshold: float,
    say: Callable[[str], None],
) -> Step:
    """Who joins `base`, of those whom the `views` show: one effect, or a set of up to `room` at once, which
    is looked for where no single one leaves little more than noise."""
    begun = promising(quiet, base, entrants_of(quiet, base, views, taken))
    enough = any(f.cost < ENOUGH * len(f.white) for f in begun)
    sets = [] if enough else starts(base, [(v.screen, v.allowed) for v in views], room)
    rivals: list[Judged] = []
    accepted, several = None, None
    if sets and sets[0].share < HIDDEN:
        accepted = several = together(quiet, held, base, sets, threshold, say)
    if several is None or several.fit.far:
        base, rivals, accepted = _one_more(quiet, held, base, begun, threshold, say)
        if sets and several is None:
            several = together(quiet, held, base, sets, threshold, say, accepted)
    if several and (several is accepted or _above(several, accepted or base, rivals)):
        rivals, accepted = [several, *rivals], several
    screened = tuple(c for view in views for c in view.seen)
    return Step(base, screened, tuple(rivals), accepted)


def _one_more(
    quiet: Scene,
    held: Scene | None,
    base: Judged,
    begun: Sequence[Fit],
    threshold: float,
    say: Callable[[str], None],
) -> tuple[Judged, list[Judged], Judged | None]:
    """(`base`, levelled; it with each of those `begun`, best first; the one that earns its place, if any
    does)."""
    rivals = each(lambda first: judge(quiet, held, first.model, 6, first), begun)
    rivals += courses(quiet, held, base, rivals) + other_teeth(quiet, held, base, rivals)
    rivals += begun_as_stated(quiet, held, base, rivals)
    for rival in rivals:
        side = rival.model.effects[-1].options.get("side", "sensor")
        say(
            f"  {rival.name} {side}: {rival.fitted - base.fitted:+.1f} fitted, "
            f"{rival.held_out - base.held_out:+.1f} held out"
        )
    base, *rivals = levelled([base, *rivals])
    rivals.sort(key=lambda j: -j.score)
    for k, rival in enumerate(rivals[:2]):  # the two that matter go on to convergence
        if rival.score > base.score:
            rivals[k] = to_the_end(quiet, held, rival)
    base, *rivals = levelled([base, *rivals])
    rivals.sort(key=lambda j: -j.score)

    def earning(among: Sequence[Judged]) -> list[Judged]:
        able = [r for r in among if earns(r, base, threshold)]
        return [r for r in able if earns(r, granted(base, r, quiet), threshold)]

    worthy = earning(rivals)
    if not worthy and (stated := spoken_against(quiet, held, base, rivals, threshold)):
        base, *rivals = levelled([base, *stated, *rivals])
        rivals.sort(key=lambda j: -j.score)
        worthy = earning(rivals)
    if worthy and base.model.effects and not (quiet.plain or quiet.observed):
        worthy = louder_than_noise(base, worthy)
    worthy = no_patch(quiet, held, base, worthy, say)
    if not worthy and not base.model.effects and crosses(quiet, base):
        # What stands is no longer nominal: it claims an effect too, and must be the better one.
        worthy = claimants(quiet, held, base, rivals, threshold)
    worthy = worthy or in_their_place(quiet, held, base, rivals, threshold)
    worthy = gaining(worthy, base)
    return base, rivals, worthy[0] if worthy else None


def _above(several: Judged, single: Judged, rivals: Sequence[Judged]) -> bool:
    """Several effects at once are worth their numbers beside `single` and the best of its `rivals`."""
    several, *others = levelled([several, single, *rivals[:1]])
    return all(several.score > other.score + KEEP for other in others)
