"""The rival without a name: smooth maps of position, velocity, acceleration, command and history.

It stands in the contest beside every named effect: maps (`terms`) are fitted as Gaussian processes,
the best one at the best port is taken, then a second one if it brings enough, each simulated in the
closed loop and judged on held-out recordings exactly as the named hypotheses are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.judging import CLEANER, PASSES, QUIET
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.choosing import (
    RECORDED,
    alike,
    drives_itself,
    earns,
    hardly_told,
    held_of,
    near,
    no_worse,
    not_far,
    score_of,
    taken_up,
)
from ffl.diagnose.maps.form import FreeForm, Ranked
from ffl.diagnose.maps.freemodel import SENT, FreeModel, FreeScreen, Part, Running
from ffl.diagnose.maps.freerank import (
    Entry,
    as_stated,
    entries_of,
    least_worth,
    measured_view,
    ranked,
)
from ffl.diagnose.maps.freestep import ROUNDS, STILL, last_gain, stepped
from ffl.diagnose.maps.known import HELD_WORTH, where_known
from ffl.diagnose.noise.colour import colouring
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.unrest import without_unrest
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.warmth import warmed, with_warmth
from ffl.systems.state_space import Array

TRIED = 6  # maps of the screen that are simulated
FINISHED = 3  # of them, fitted to convergence
BENT = 5.0  # times what is believed of a number of the linear model: it stands for something else


def free_form(
    scene: Scene, held: Scene | None, model: Model, most: int = 1, names: Sequence[str] = ()
) -> list[FreeForm]:
    """The maps that explain best what `model` leaves, `most` at once last; the model itself is first.
    `names`: of the maps that may enter, all where empty."""
    current = bare(scene, held, model)
    if current is None:
        return []
    out = [current]
    for _ in range(most):
        better = _one_more(current, held, names)
        if better is None:
            break
        out.append(better)
        current = better
    return out


def bare(scene: Scene, held: Scene | None, model: Model) -> FreeForm | None:
    residuals = scene.residuals(model)
    if residuals is None:
        return None
    quiet = replace(scene, noise=least_noise(scene, model, residuals))
    fitted = fit(quiet, model)
    return judged(replace(quiet, loop=fitted.loop), held, FreeModel(fitted.model), 0.0)


def judged(
    scene: Scene, held: Scene | None, free: FreeModel, gain: float, left: Array | None = None
) -> FreeForm | None:
    """`free` with what it leaves, fitted and held out; None where it leaves all bounds. `left`: the
    whitened residual, where it is known."""
    if left is None:
        residuals = scene.residuals(free)
        if residuals is None:
            return None
        left = scene.whiten(residuals)
    white, known = np.zeros(0), np.zeros(0, bool)
    if held is not None and held.trials:
        held = with_warmth(held.like(scene), free)
        runs = [free.follow(trial) for trial in held.trials]
        if any(run is None for run in runs):
            return None
        missed = [t.y - r[0].y for t, r in zip(held.trials, runs, strict=True) if r]
        pairs = zip(runs, missed, strict=True)
        known = np.concatenate([where_known(free, r[0].x, held, e) for r, e in pairs if r])
        white = held.judge(missed, known)
    return FreeForm(free, scene, gain, left, white, known, held=held)


def _one_more(current: FreeForm, held: Scene | None, names: Sequence[str]) -> FreeForm | None:
    """`current` with one more map, if one is worth it."""
    scene = current.scene
    view = FreeScreen(scene, current.free)
    views = [v for v in (view, measured_view(current, view.fit)) if v is not None]
    taken = {(p.term.name, p.place) for p in current.parts}
    force = next((p.place for p in current.parts if p.place.port == "force"), None)
    entries = [
        (t, p)
        for t, p in entries_of(current.free.model, [*scene.trials, *(held.trials if held else ())])
        if (not names or t.name in names)
        and (t.name, p) not in taken
        and (p.side != SENT or current.cost > RECORDED * len(current.white))
        and (t.port != "force" or force is None or p == force)
    ]
    found = [ranked(view, current, entries) for view in views]
    if not found[0]:
        return None

    def tried_out(entry: Entry) -> list[FreeForm]:
        ground = warmed(scene, entry.warmth)
        if entry.view.along is None:
            ways = [(view.of(ground), current.free.beside(entry.part))]
            ways += _unbent(current, entry.part)
        else:
            ways = _begun(ground, entry.begun)
        ended = (_tried(current, held, *way, entry.evidence.gain) for way in ways)
        return [f for f in ended if f and f.free.believable]

    def finished(f: FreeForm) -> FreeForm:
        screen = FreeScreen(f.scene, f.free)
        f = _fitted(screen, f.free, held, f.evidence, np.inf, ROUNDS) or f
        return _weighed(_started(_settled(screen, f)), current)

    worth = [e for some in found for e in some[:TRIED] if e.evidence.gain >= least_worth(some)]
    tried = [f for some in each(tried_out, worth) for f in some]
    # Those that help where nothing was fitted come first, however much others take off what was.
    tried.sort(key=lambda f: (held_of(current, f) < -HELD_WORTH, -score_of(f, current)))
    # Those that matter go on to convergence; who promises most may begin furthest from where it ends, and
    # who promises nearly as much may be what cannot be told from it.
    first = [some[0].part for some in found if some] + near(found[0])
    matter = [
        f
        for k, f in enumerate(tried)
        if k < FINISHED or any(f.parts[-1].same(part) for part in first)
    ]
    ended = [f for f in each(finished, matter) if f.free.believable]
    done = not_far([f for f in ended if earns(f, current)])
    if not any(score_of(f, current) > 0 for f in done):
        return None
    best = min(
        no_worse(done, current),
        key=lambda f: (
            drives_itself(f),
            taken_up(f),
            len(f.parts[-1].term.variables),
            -score_of(f, current),
        ),
    )
    seen = [e for e in worth if e.view.along is None]
    listed = _listed(found[0], seen, [*tried, *ended], current)
    rivals = tuple(f.parts[-1] for f in done if alike(f, best))
    return replace(
        _quieter(best),
        ranking=current.ranking or listed,
        untold=hardly_told(current, best),
        alike=rivals,
    )


def _listed(
    entries: Sequence[Entry], tried: Sequence[Entry], ended: Sequence[FreeForm], before: FreeForm
) -> tuple[Ranked, ...]:
    """Every map with its evidence: to first order, and of those that were fitted no more than they took
    off."""
    out = []
    for e in entries:
        gain = e.evidence.gain
        if e in tried:
            took = [0.5 * (before.cost - f.cost) for f in ended if f.parts[-1].same(e.part)]
            gain = max(min(gain, max(took, default=0.0)), 0.0)
        out.append(Ranked(e.part.term.name, e.part.place.words, gain))
    return tuple(sorted(out, key=lambda r: -r.evidence))


def _tried(
    current: FreeForm, held: Scene | None, screen: FreeScreen, start: FreeModel, gain: float
) -> FreeForm | None:
    """A further map fitted from `start`, which is not where `current` stands where numbers began anew."""
    ways = (_fitted(screen, start, held, current.evidence, gain, n) for n in (1, ROUNDS))
    found = next((way for way in ways if way), None)  # half way it may run away held out
    if found is None:
        return None
    return replace(found, evidence=current.evidence + min(gain, 0.5 * (current.cost - found.cost)))


def _begun(scene: Scene, free: FreeModel) -> list[tuple[FreeScreen, FreeModel]]:
    """`free` with the screen of where it stands; none where it leaves all bounds."""
    return [] if scene.residuals(free) is None else [(FreeScreen(scene, free), free)]


def _unbent(current: FreeForm, part: Part) -> list[tuple[FreeScreen, FreeModel]]:
    """Blank `part` beside the linear model as stated, where its numbers left what is believed of them and
    maps do not stand yet: bent to stand for what is missing they keep the map from where it belongs, and
    tell what the recordings began warm with as wrong. (Of a motor that fades as it warms the mass had gone
    up by 19 %: from there the map left 88,000 of 17,840 squares, from the stated one 20,700.)"""
    model = current.free.model
    pairs = zip(model.theta, model.coordinates, strict=True)
    if current.parts or all(abs(t) < BENT * c.doubt for t, c in pairs):
        return []
    return _begun(current.scene, FreeModel(as_stated(model)).beside(part))


def _weighed(f: FreeForm, before: FreeForm) -> FreeForm:
    """`f` with the evidence of its last map along the motion that all of them make where that is more, and
    no more than they take off: to first order beside the loop without it, what enters at the sensor is told
    short. (What a machine began warm with is a gain to first order: beside it heat is told short there.)"""
    left = before.scene.like(f.scene).residuals(before.free)
    whole = before.cost if left is None else float(np.sum(f.scene.whiten(left) ** 2))
    gain = max(f.evidence - before.evidence, last_gain(FreeScreen(f.scene, f.free), f.free))
    return replace(f, evidence=before.evidence + min(gain, 0.5 * (whole - f.cost)))


def _settled(screen: FreeScreen, f: FreeForm) -> FreeForm:
    """Heat maps and what the recordings began warm with, by turns, as long as that brings much."""
    for _ in range(PASSES):
        other = screen.of(with_warmth(f.scene, f.free))
        if other.scene is f.scene:
            break
        again = _fitted(other, f.free, f.held, f.evidence, np.inf, ROUNDS)
        if again is None or not again.cost < f.cost:
            break
        gained = f.cost - again.cost
        f = replace(again, evidence=f.evidence + 0.5 * gained)  # the warmth's share included
        if gained < STILL * f.cost:
            break
    return f


def _started(f: FreeForm) -> FreeForm:
    """The same with the starts of recordings that begin in motion, or with springs that the maps wind up,
    as the maps have them: those that were read without them speak against them. (A magnet beside which
    two modes stood wound up: the first 0.1 s of 7 left half as much as all noise, and a map that left
    1/136 of the squares was slow noise.)"""
    running = Running(f.free)
    grounds = [f.scene] if f.held is None else [f.scene, f.held.like(f.scene)]
    begun = [with_starts(ground, running) for ground in grounds]
    if all(a is b for a, b in zip(begun, grounds, strict=True)):
        return f
    scene, *others = begun
    return judged(scene, others[0] if others else None, f.free, f.evidence) or f


def _quieter(found: FreeForm) -> FreeForm:
    """Fitted again under the noise that is left now that the map explains its share, as long as that
    changes it; the first opinion may have been too low as well as too high."""
    for _ in range(PASSES):
        scene = found.scene
        residuals = scene.residuals(found.free) or []
        left = found.cost / max(len(found.white), 1)
        scene = replace(scene, loop=colouring(found.free.model, left))
        other = scene.with_noise_of(residuals, coloured=False, quantile=QUIET)
        screen = FreeScreen(other, found.free)
        again = _fitted(screen, found.free, found.held, found.evidence, 0.0, ROUNDS)
        if again is None:
            break
        found = again
        shares = (other.noise.force / scene.noise.force, other.noise.sensor / scene.noise.sensor)
        if min(shares) > CLEANER:
            break
    return found


def calmed(found: FreeForm) -> FreeForm:
    """Maps in place of names, what these made loud counting in full again. (A limit and a mode, in place of
    a stop, were to answer noise seven times as loud: of the map's floor a fifth was told.)"""
    if (scene := without_unrest(found.scene)) is found.scene:
        return found
    held = None if found.held is None else without_unrest(found.held)
    calm = judged(scene, held, found.free, found.evidence)
    return (
        found if calm is None else replace(_quieter(calm), ranking=found.ranking, alike=found.alike)
    )


def _fitted(
    screen: FreeScreen, free: FreeModel, held: Scene | None, before: float, gain: float, rounds: int
) -> FreeForm | None:
    """All maps together in the closed loop. The evidence is `before` plus `gain`, or what the simulation
    makes of it where that is less."""
    found = stepped(screen, free, rounds)
    if found is None:
        return None
    free, now, gained = found
    return judged(screen.scene, held, free, before + min(gain, 0.5 * gained), now.white)
