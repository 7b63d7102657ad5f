"""Columns that are not of one clock, beside physics that the model leaves out, where no controller's
equation tells.

A command that was stamped k samples late is told by what the model makes of it (`recorded.early`) unless
friction hides it: then nothing that is named leaves only noise, and no shift does. Both together do. So
with every shift, and with every rate of one column's clock against the other's, the model is fitted anew,
alone and beside the dry friction, load or damper that balances the forces then. The sum of squares
falls as a parabola on the way to the true one, (k - k_0)^2, to the noise. (5 samples, and 0.15 %, each
beside Coulomb friction: 1,688 and 1,014 times the stated noise as recorded, 2.3 and 0.2 there; both
were a friction of half its size and dampers that nobody had.) The same of one recording alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.interpolate import CubicSpline

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.ground import Ground
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import of_the_machine
from ffl.diagnose.predict.balance import rubbing
from ffl.diagnose.recorded.against_controller import Fault
from ffl.diagnose.recorded.equation import SHIFTS
from ffl.diagnose.recorded.trials import stretches
from ffl.recordings import Recording

LOUD = 4.0  # times the stated noise, in the mean square: what is left must be more
CLEAR = 0.1  # of what is left as recorded, by what stands and by any friction: at most, once moved
CONFIRMED = 0.3  # the same of recordings that judge
FALLS = 0.98  # of what is left: a first step that leaves more leads nowhere
LONGEST = 20_000  # samples looked at
OVERLAP = 0.5  # of the shortest piece: the columns lie beside one another for as much at least
TURNS = 4  # of the search for a shift and for a rate
RATE = 0.02  # a clock that is further off is another sample time
FINEST = 0.25  # of a sample, at the end of a recording: a rate is looked for as closely


@dataclass(frozen=True)
class _Clock:
    """u so many samples late, and y's clock so much faster than u's (relative)."""

    late: int = 0
    rate: float = 0.0

    def undone(self, recording: Recording, origins: Mapping[str, float]) -> Recording:
        """The recording on one clock: y as it was when u was sent. Both began at its origin, by source: a
        piece is off by as much as went before."""
        r = recording
        if self.rate:
            each = np.arange(len(r))
            at = each + self.rate * (each + (r.t[0] - origins[r.source]) / r.sample_time)
            within = np.flatnonzero((at >= 0.0) & (at <= each[-1]))
            y = CubicSpline(each, r.y)(at[within])
            shown = np.array_equal(r.r, r.y)  # an observer's reference is y
            r = r[int(within[0]) : int(within[-1]) + 1]
            r = replace(r, y=y, r=y if shown else r.r)
        if self.late:
            n, k = len(r), self.late
            sent = r[max(k, 0) : n + min(k, 0)]
            seen = r[max(-k, 0) : n - max(k, 0)]
            r = replace(seen, u=sent.u, f=sent.f)
        return r


def off_clock(
    ground: Ground, standing: Judged, say: Callable[[str], None] = lambda line: None
) -> Fault | None:
    """u late against y, or on another clock, where that with a friction leaves a tenth at most of what all
    that stands, or any friction, leaves of the recordings as they are; None otherwise."""
    scene = replace(ground.scene, noise=ground.prior)
    if scene.plain or ground.seen.folded or ground.told.acting:
        return None
    stands = scene.residuals(standing.model)
    most = np.inf if stands is None else _square(scene, stands)
    if most < LOUD:
        return _judge_off(ground, scene, standing)
    say("checking whether a shift or another clock of u would explain what is left")
    fitted = stretches(ground.recordings, LONGEST)
    origins, longest = _origins([*ground.recordings, *ground.validation])
    shortest = min(map(len, fitted))

    @cache
    def left(clock: _Clock, source: str | None = None) -> tuple[float, Model]:
        """(mean square of what the best leaves where all recordings, or one alone, are on that clock, the
        best)."""
        if abs(clock.late) + abs(clock.rate) * longest > OVERLAP * shortest:
            return np.inf, ground.told
        moved = ground.trials(_undone(clock, fitted, origins, source))
        on = replace(scene, trials=moved)
        found = [fit(on, model) for model in _models(ground.told, on)]
        best = min(found, key=lambda f: f.cost)
        return best.cost / len(best.white), best.model

    def of(clock: _Clock) -> float:
        return left(clock)[0]

    best, most_late = _Clock(), min(SHIFTS, shortest // 4)
    for _ in range(TURNS):
        begun = best
        ways = (1, -1) if begun.rate else (1,)
        later = [_late(of, begun, most_late, way) for way in ways]
        faster = [_off(of, begun, longest, pivot) for pivot in (0.0, 0.5)]
        best = min((begun, *later, *faster), key=of)
        if best == begun:
            break
    physics = min(
        of(_late(of, _Clock(), most_late, -1)), most
    )  # a delay, which a rate does in part
    before = left(_Clock())[1]
    if of(best) <= CLEAR * physics and _told(best, longest):
        if not _confirmed(ground, scene, (best, None), origins, before, left(best)[1]):
            return None
        said = _said(best, ground.seen.model.sample_time, longest)
        return Fault(fitted[0].source, "shift", "the time base", said)
    for source in dict.fromkeys(r.source for r in fitted):
        alone = partial(_left_by_one, left, source)
        clock = min((_late(alone, _Clock(), most_late, way) for way in (1, -1)), key=alone)
        if clock.late and alone(clock) <= CLEAR * physics:
            after = left(clock, source)[1]
            if _confirmed(ground, scene, (clock, source), origins, before, after):
                return _of_one(source, clock, ground.seen.model.sample_time)
    return None


def _left_by_one(
    left: Callable[[_Clock, str | None], tuple[float, Model]], source: str, clock: _Clock
) -> float:
    return left(clock, source)[0]


def _undone(
    clock: _Clock,
    recordings: Sequence[Recording],
    origins: Mapping[str, float],
    source: str | None = None,
) -> list[Recording]:
    """All on one clock, or those of one `source` alone."""
    mine = [source in (None, r.source) for r in recordings]
    return [clock.undone(r, origins) if own else r for own, r in zip(mine, recordings, strict=True)]


def _judge_off(ground: Ground, scene: Scene, standing: Judged) -> Fault | None:
    """The columns of one recording that judges against one another, where what stands leaves noise of all
    that was fitted: far more of this one, and a tenth of it once u is moved."""
    judging = stretches(ground.validation, LONGEST)
    own = {r.source for r in ground.recordings}
    for source in dict.fromkeys(r.source for r in judging if r.source not in own):
        pieces = [r for r in judging if r.source == source]
        most_late = min(SHIFTS, min(map(len, pieces)) // 4)
        left = cache(partial(_left_of, ground, scene, standing.model, pieces))
        if not left(_Clock()) > LOUD:
            continue
        clock = min((_late(left, _Clock(), most_late, way) for way in (1, -1)), key=left)
        if clock.late and left(clock) <= CLEAR * left(_Clock()):
            return _of_one(source, clock, ground.seen.model.sample_time)
    return None


def _left_of(
    ground: Ground, scene: Scene, model: Model, pieces: Sequence[Recording], clock: _Clock
) -> float:
    """Mean square of what the `model` leaves of recordings put on that clock."""
    held = replace(scene, trials=ground.trials(_undone(clock, pieces, {})))
    residuals = held.residuals(model)
    return np.inf if residuals is None else _square(held, residuals)


def _of_one(source: str, clock: _Clock, sample_time: float) -> Fault:
    k, way = abs(clock.late), "late" if clock.late > 0 else "early"
    return Fault(
        source, "shift", "the time base of this recording",
        f"u is {k} sample{'s'[: k > 1]} ({k * sample_time:.4g} s) {way} against y in this recording, not "
        "in the others: align its columns, or leave it out",
    )  # fmt: skip


def _models(told: Model, scene: Scene) -> list[Model]:
    """The model alone, and beside each of what balances the forces of the scene's recordings."""
    rubs, places = rubbing(scene.trials, told), of_the_machine(told)
    beside = [told.with_effect(replace(f, options=p.options)) for f in rubs for p in places]
    return [told, *beside]


def _late(left: Callable[[_Clock], float], begun: _Clock, most: int, way: int) -> _Clock:
    """The shift at the bottom of the valley that goes down one `way` from `begun`: by twice as many samples
    as long as that helps, then back by half."""

    def by(k: int) -> _Clock:
        return replace(begun, late=begun.late + k)

    if left(by(way)) > FALLS * left(begun):
        return begun
    at = way
    while abs(2 * at) <= most and left(by(2 * at)) < left(by(at)):
        at *= 2
    step = abs(at) // 2
    while step:
        near = [k for k in (at - step, at, at + step) if abs(k) <= most]
        best = min(near, key=lambda k: left(by(k)))
        at, step = best, (step // 2 if best == at else step)
    return by(at)


def _off(left: Callable[[_Clock], float], begun: _Clock, samples: float, pivot: float) -> _Clock:
    """The rate there, from one sample at the end of the longest recording on, in the same way; columns stay
    as they lie at the `pivot`, a share of it."""

    def by(rate: float) -> _Clock:
        return _Clock(begun.late + round(pivot * rate * samples), begun.rate + rate)

    first = min((1.0 / samples, -1.0 / samples), key=lambda rate: left(by(rate)))
    if left(by(first)) > FALLS * left(begun):
        return begun
    at = first
    while abs(2.0 * at) <= RATE and left(by(2.0 * at)) < left(by(at)):
        at *= 2.0
    step = 0.5 * abs(at)
    while step * samples >= FINEST:
        best = min((at - step, at, at + step), key=lambda rate: left(by(rate)))
        at, step = best, (0.5 * step if best == at else step)
    return by(at)


def _origins(recordings: Sequence[Recording]) -> tuple[dict[str, float], float]:
    """(when the clocks of a recording began, by source: at zero, but for times of day; samples of the
    longest since then)."""
    pieces: dict[str, list[Recording]] = {}
    for r in recordings:
        pieces.setdefault(r.source, []).append(r)
    origins, longest = {}, 0.0
    for source, own in pieces.items():
        first, last = min(float(r.t[0]) for r in own), max(float(r.t[-1]) for r in own)
        origins[source] = 0.0 if 0.0 <= first <= last - first else first
        longest = max(longest, (last - origins[source]) / own[0].sample_time)
    return origins, longest


def _told(clock: _Clock, samples: float) -> bool:
    """Late by a sample, or off by one at the end; not y late alone."""
    return clock.late >= 1 or abs(clock.rate) * samples >= 1.0


def _confirmed(
    ground: Ground,
    scene: Scene,
    moved: tuple[_Clock, str | None],
    origins: Mapping[str, float],
    before: Model,
    after: Model,
) -> bool:
    """Whether recordings that judge say so as well, with all numbers as fitted; `moved`: a clock, and the
    source of the one recording that is on it, None for all."""
    judging, found = stretches(ground.validation, LONGEST), []
    (clock, source) = moved
    on_one = _undone(clock, judging, origins, source)
    for model, pieces in ((before, judging), (after, on_one)):
        held = replace(scene, trials=ground.trials(pieces))
        residuals = held.residuals(model)
        found.append(np.inf if residuals is None else _square(held, residuals))
    return found[1] <= CONFIRMED * found[0]


def _square(scene: Scene, residuals: list[np.ndarray]) -> float:
    return float(np.mean(scene.whiten(residuals) ** 2))


def _said(clock: _Clock, sample_time: float, samples: float) -> str:
    parts, mend = [], ""
    if clock.late:
        k, order = abs(clock.late), "before" if clock.late > 0 else "after"
        parts.append(
            f"y answers u {k} sample{'s'[: k > 1]} ({k * sample_time:.4g} s) {order} the model does"
        )
        mend = "align the columns, or take so much delay out of the plant file"
    if clock.rate:
        way = "fast" if clock.rate > 0 else "slow"
        parts.append(
            f"y's clock is {100.0 * abs(clock.rate):.2g} % {way} against u's, "
            f"{abs(clock.rate) * samples:.0f} samples at the end"
        )
        mend = "record both by one clock, or resample one of them"
    return f"{', and '.join(parts)}, whatever friction there is: {mend}"
