"""The rival without a name: smooth maps of position, velocity, acceleration, command and history.

It stands in the contest beside every named effect: maps (`terms`) are fitted as Gaussian processes,
the best one at the best port is taken, then a second one if it brings enough, each simulated in the
closed loop and judged on held-out recordings exactly as the named hypotheses are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.earning import HALF, LOST, UNTOLD, promised
from ffl.diagnose.contest.judging import CLEANER, PASSES, QUIET, effective
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.freemodel import SENT, FreeModel, FreeScreen, Part, Running
from ffl.diagnose.maps.freerank import WORTH, Entry, entries_of, least_worth, measured_view, ranked
from ffl.diagnose.maps.freestep import ROUNDS, STILL, last_gain, stepped
from ffl.diagnose.maps.known import HELD_WORTH, hardly_shown, where_known
from ffl.diagnose.noise.colour import colouring
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.unrest import without_unrest
from ffl.diagnose.recorded.starts import with_starts
from ffl.diagnose.recorded.warmth import warmed, with_warmth
from ffl.systems.state_space import Array

TRIED = 6  # maps of the screen that are simulated
FINISHED = 3  # of them, fitted to convergence
SHARE = 0.004  # of the number of samples: log-likelihood that a further map must bring
RECORDED = 2.0  # times the squares that a map of what was recorded leaves: less than were there
FAR = 2.5  # times what another map leaves: a map that leaves more is not nearly right
SIMPLER = 0.97  # share of the best score at which a map of fewer variables is preferred, if it
NO_WORSE = 1.25  # leaves no more than this of what the best one leaves
CLOSE = 1.1  # times what another map leaves of held-out recordings: as much as it does


@dataclass(frozen=True)
class Ranked:
    """A map by name, where it would enter, and the log-evidence it has to first order."""

    name: str
    port: str
    evidence: float


@dataclass(frozen=True)
class FreeForm:
    """A hypothesis without a name: its maps, and what it leaves.

    `evidence`: gained by the maps in the fitted recordings; `white`, `held_white`: whitened residuals
    under `scene`'s noise; `known`: held-out samples at which the maps can be judged, since the machine
    is, and has been for a while, where it was in the fitted recordings. `ranking`: all maps at all
    ports as they were screened, best first. `scene` and `held` begin as the maps have it, where a
    recording begins in motion. `untold`: the held-out recordings hardly show the maps. `alike`: other
    maps that do as much in the place of the last one.
    """

    free: FreeModel
    scene: Scene
    evidence: float
    white: Array
    held_white: Array
    known: Array
    ranking: tuple[Ranked, ...] = ()
    held: Scene | None = None
    untold: bool = False
    alike: tuple[Part, ...] = ()

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.free.parts

    @property
    def name(self) -> str:
        return " + ".join(p.term.name for p in self.parts) or "nothing"

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(v for p in self.parts for v in p.term.variables))

    @property
    def cost(self) -> float:
        return float(self.white @ self.white)

    @property
    def held_cost(self) -> float:
        """Mean square of the held-out residual where it can be judged; 0 where there is none."""
        return float(np.mean(self.held_white[self.known] ** 2)) if self.known.any() else 0.0

    @property
    def port(self) -> str:
        return self.parts[0].place.port if self.parts else ""


def held_gain(before: Array, after: Array, known: Array) -> float:
    """Log-likelihood that held-out residuals gain, n/2 log(mean square before/after), the scale free;
    n: independent samples of the better one. Only samples that are `known` count."""
    if not known.any():
        return 0.0
    a, b = before[known], after[known]
    first, second = float(np.mean(a**2)), float(np.mean(b**2))
    if first == second:
        return 0.0
    return 0.5 * effective(b if second < first else a) * float(np.log(first / second))


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
        for t, p in entries_of(current.free.model)
        if (not names or t.name in names)
        and (t.name, p) not in taken
        and (p.side != SENT or current.cost > RECORDED * len(current.white))
        and (t.port != "force" or force is None or p == force)
    ]
    found = [ranked(view, current, entries) for view in views]
    if not found[0]:
        return None

    def tried_out(entry: Entry) -> FreeForm | None:
        ground, start = warmed(scene, entry.warmth), current.free.beside(entry.part)
        screen, gain = view.of(ground), entry.evidence.gain
        if entry.view.along is not None:
            start = entry.begun
            if ground.residuals(start) is None:
                return None
            screen = FreeScreen(ground, start)
        ways = (_fitted(screen, start, held, current.evidence, gain, n) for n in (1, ROUNDS))
        found = next((way for way in ways if way), None)  # half way it may run away held out
        if found is None or entry.view.along is None:
            return found
        took = min(gain, 0.5 * (current.cost - found.cost))
        return replace(found, evidence=current.evidence + took)

    def finished(f: FreeForm) -> FreeForm:
        screen = FreeScreen(f.scene, f.free)
        f = _fitted(screen, f.free, held, f.evidence, np.inf, ROUNDS) or f
        return _weighed(_started(_settled(screen, f)), current)

    worth = [e for some in found for e in some[:TRIED] if e.evidence.gain >= least_worth(some)]
    tried = [f for f in each(tried_out, worth) if f is not None and f.free.believable]
    # Those that help where nothing was fitted come first, however much others take off what was.
    tried.sort(key=lambda f: (_held(current, f) < -HELD_WORTH, -_score(f, current)))
    # Those that matter go on to convergence; who promises most may begin furthest from where it ends, and
    # who promises nearly as much may be what cannot be told from it.
    first = [some[0].part for some in found if some] + _near(found[0])
    matter = [
        f
        for k, f in enumerate(tried)
        if k < FINISHED or any(f.parts[-1].same(part) for part in first)
    ]
    ended = [f for f in each(finished, matter) if f.free.believable]
    done = _not_far([f for f in ended if _earns(f, current)])
    if not any(_score(f, current) > 0 for f in done):
        return None
    best = min(
        _no_worse(done, current),
        key=lambda f: (_drives_itself(f), len(f.parts[-1].term.variables), -_score(f, current)),
    )
    listed = tuple(Ranked(e.part.term.name, e.part.place.words, e.evidence.gain) for e in found[0])
    untold, alike = _untold(current, best), tuple(f.parts[-1] for f in done if _alike(f, best))
    return replace(_quieter(best), ranking=current.ranking or listed, untold=untold, alike=alike)


def _near(listed: Sequence[Entry]) -> list[Part]:
    """The maps of one variable that to first order are worth as much as the best."""
    least = SIMPLER * listed[0].evidence.gain
    near = [e.part for e in listed if e.evidence.gain >= least]
    return [part for part in near if len(part.term.variables) == 1]


def _alike(f: FreeForm, best: FreeForm) -> bool:
    """Recordings cannot tell `f`, of other variables than `best` and not of more, from it. (Where a spring
    holds a slow stage, what depends on the command and what depends on the position are one.)"""
    own, other = best.parts[-1].term.variables, f.parts[-1].term.variables
    if set(own) & set(other) or len(other) > len(own):
        return False
    known = f.known & best.known
    ahead = held_gain(f.held_white, best.held_white, known)
    left, least = (float(np.sum(one.held_white[known] ** 2)) for one in (f, best))
    # Neither is drawn exactly: of long recordings a few per cent of the noise are many times a likelihood.
    return 0.5 * (f.cost - best.cost) < WORTH and (ahead < HELD_WORTH or left < CLOSE * least)


def _drives_itself(f: FreeForm) -> bool:
    """With less than no damping: of maps that do as much the others come first. (A force by position
    beside -1.4 times the stated damping stood for an amplifier weaker one way.)"""
    return f.free.model.corrections.get("damping", 0.0) < -1.0


def _weighed(f: FreeForm, before: FreeForm) -> FreeForm:
    """`f` with the evidence of its last map along the motion that all of them make where that is more, and
    no more than they take off: to first order beside the loop without it, what enters at the sensor is told
    short. (What a machine began warm with is a gain to first order: beside it heat is told short there.)"""
    left = before.scene.like(f.scene).residuals(before.free)
    whole = before.cost if left is None else float(np.sum(f.scene.whiten(left) ** 2))
    gain = max(f.evidence - before.evidence, last_gain(FreeScreen(f.scene, f.free), f.free))
    return replace(f, evidence=before.evidence + min(gain, 0.5 * (whole - f.cost)))


def _not_far(done: Sequence[FreeForm]) -> list[FreeForm]:
    """Those beside whom no other leaves so much less, fitted and held out alike, that they are not nearly
    right, whatever they took off. (Of heat in a servo's stage a map that sees the command as recorded took
    off nine tenths, feedback's answer in it, and left eight times what heat left.)"""
    return [
        f
        for f in done
        if not any(FAR * g.cost < f.cost and FAR * g.held_cost < f.held_cost for g in done)
    ]


def _no_worse(done: Sequence[FreeForm], current: FreeForm) -> list[FreeForm]:
    """The map of the best score, and those near it that leave hardly more than it does, in the fitted and
    in the held-out recordings."""
    best = max(done, key=lambda f: _score(f, current))
    least = SIMPLER * _score(best, current)
    return [
        f
        for f in done
        if _score(f, current) >= least
        and f.cost <= NO_WORSE * best.cost
        and f.held_cost <= NO_WORSE * best.held_cost
    ]


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
    """The same with the starts of recordings that begin in motion as the maps have them: those that
    were read without them speak against them."""
    grounds = [f.scene] if f.held is None else [f.scene, f.held]
    if all(t.at_rest for ground in grounds for t in ground.trials):
        return f
    running = Running(f.free)
    scene, *others = (with_starts(ground.like(f.scene), running) for ground in grounds)
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


def _score(f: FreeForm, before: FreeForm) -> float:
    return f.evidence - before.evidence + _held(before, f)


def _earns(f: FreeForm, before: FreeForm) -> bool:
    """Enough in fitted and held-out recordings alike; a further map must not patch what the first one
    leaves imperfect."""
    fitted, held = f.evidence - before.evidence, _held(before, f)
    if any(p.place.side == SENT for p in f.parts) and before.cost < RECORDED * f.cost:
        return False  # feedback makes the command of the noise too (a null: 243 nats, 5 % of the squares)
    if before.parts and (fitted < SHARE * len(f.white) or held < SHARE * int(f.known.sum())):
        return False
    if not before.held_white.size:
        return fitted > WORTH
    if _untold(before, f):
        return fitted > UNTOLD and held > -max(HELD_WORTH, LOST * fitted)
    # Of little that could be told there, half.
    sure = fitted > UNTOLD and held > HALF * _promise(before, f)
    return fitted > WORTH and (held > HELD_WORTH or sure)


def _promise(before: FreeForm, after: FreeForm) -> float:
    """See `promised`, where the maps are known."""
    if not before.held_white.size:
        return np.inf
    return promised(after.held_white, before.held_white, after.known)


def _untold(before: FreeForm, after: FreeForm) -> bool:
    """The held-out recordings hardly show the maps."""
    return hardly_shown(_promise(before, after), after.evidence - before.evidence)


def _held(before: FreeForm, after: FreeForm) -> float:
    return held_gain(before.held_white, after.held_white, after.known)


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
