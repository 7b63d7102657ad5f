"""Commands that did not arrive: a bus that loses a packet leaves the drive with what it had.

At a lost sample the drive differs from the command by d = a[k-1] - u[k], a being what it really got: a
force that is known in size and sign, at samples that are not. No map of the motion has it, and in
the mean it passes for a delay of as many samples as the share p that is lost. With s the
correlation of the whitened residual with what a unit force of one sample does to it, of energy P,

    log L(p) = sum_k log((1 - p) + p exp(d_k s_k - d_k^2 P/2))

where the samples' traces do not overlap; where they do, the posterior of every sample is found beside the
others' expected force, and what is summed bounds the likelihood from below (mean field). So samples that
are faint by themselves count together. The same likelihood for forces of the other sign, which
nothing makes, says what mere scatter would give.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.signal import fftconvolve

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.form import held_gain
from ffl.diagnose.noise.doubt import judged_by
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.knocks import trace_of_push
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

# Shares of the commands that are tried, and, times the mean square left, what noise may be without them.
RATES = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
QUIETER = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35)
FIRST = ((0.02, 0.8), (0.1, 0.9), (0.3, 0.9))  # of both, tried before all others
TURNS = 2  # of the search for both, one after the other
WORTH = 40.0  # log-likelihood that lost samples must bring beyond those of the other sign
# The same where little is to be expected: of recordings that judge, and of noise as heard.
HINT = 8.0
# Of it that the other sign may reach: where commands change sign from sample to sample they are
# another sample's and reach 0.28 of it.
ALIKE, RINGING = 0.5, 0.75  # and where recordings judge what others show without it
# Most of the samples that are lost where no other recording confirms it: coloured noise is drawn by many a
# little. (Of 400 nulls two had lost 15 and 24 % of them.)
SELDOM = 0.1
UNTOLD = 5.0  # times `WORTH`: the same where other recordings cannot confirm it
# Times what the largest rate brings: no sample lost does more than its own force (a magnet 5, a creep 3).
# Where a loop rings also of what its own rate promises, and no less than the least of that.
MOST, LEAST = 2.0, 0.5
# Of what its own rate promises: scatter reached 0.06 of it where recordings judge, what was lost at
# least 0.24.
KEPT = 0.12
AGAIN = 0.3  # of what is to be expected of recordings that judge, from which they are asked
ENERGY = 0.999  # of what one sample does to the residual, from which its length is taken
MEMORY = 2048  # samples of it at most
PASSES = 2  # once found, the model's own numbers no longer stand in for them
ROUNDS = 6
# Sweeps until the evidence counts in full: who comes first must not take what is another's.
HEATED = 8
SWEEPS = 14  # of the posteriors, each beside the others'
FAINT = 3e-3  # of a standard deviation: changes of a sample's force that no other sample feels


@dataclass(frozen=True)
class Search:
    """`scene` with the force to be expected of lost samples as loads; the share that is lost (`rate`), the
    number of those that must have been (`lost`); log-likelihood that they bring (`gain`), that
    those of the `other` sign would, and what this rate (`promise`) and the largest (`most`) bring in the
    mean."""

    scene: Scene
    rate: float
    lost: float
    gain: float
    other: float
    promise: float
    most: float

    @property
    def found(self) -> bool:
        return self.shows(WORTH)

    def shows(self, worth: float, alike: float = ALIKE) -> bool:
        """Beyond those of the other sign by `worth`, which reach less than `alike` of it, and by what lost
        samples of this rate may bring."""
        more = self.gain - max(self.other, 0.0) > worth and self.other < alike * self.gain
        return more and KEPT * self.promise < self.gain and self.possible

    @property
    def hints(self) -> bool:
        """As far as its own rate may bring it: noise alone brought 26 once where 6 were promised, what was
        lost 13 to 52 of 42 to 48."""
        return self.shows(HINT) and self.gain < MOST * self.promise + HINT

    @property
    def agrees(self) -> bool:
        """As much as its own rate promises, and beyond the other sign, which is nearer to it where a loop
        rings (0.55 and 0.72 of it; in the recordings that were fitted less than nothing)."""
        as_much = LEAST * self.promise < self.gain < MOST * self.promise
        return as_much and self.shows(WORTH, RINGING)

    @property
    def possible(self) -> bool:
        """No more than lost samples can bring, and not at the end of the rates: a drive that seems to keep
        every third of its commands from before is slow otherwise (a creep took 0.3 of them)."""
        return self.gain < max(WORTH, MOST * self.most) and self.rate < RATES[-1]


@dataclass(frozen=True)
class Dropouts:
    """`fit` of the model without effects beside what was lost, in the recordings that were fitted and
    those that judge; `confirmed`: these had to show it and did; `white`, `held_white`: residuals
    whitened by the noise of `fitted`, what was lost still in them."""

    fit: Fit
    fitted: Search
    held: Search | None
    confirmed: bool
    white: Array
    held_white: Array

    def gains(self, scene: Scene, held: Scene | None, standing: Model) -> tuple[float, float]:
        """(fitted, held out) log-likelihood over what `standing` leaves of the recordings as they are."""
        rivals = [(scene, self.white, self.fitted)]
        if held is not None and self.held is not None:
            rivals.append((held, self.held_white, self.held))
        out = []
        for ground, white, search in rivals:
            quiet = ground.like(self.fitted.scene)
            left = quiet.residuals(standing)
            everything = np.ones(len(white), bool)
            ahead = np.inf if left is None else held_gain(quiet.judge(left), white, everything)
            out.append(ahead + search.gain)
        return out[0], out[-1]


def dropouts(scene: Scene, held: Scene | None, nominal: Model) -> Dropouts | None:
    """What did not arrive; None where there is no sign of it, or commands were not recorded."""
    judging = held if held is not None and held.trials else None
    trials = [*scene.trials, *(judging.trials if judging else ())]
    if scene.observed or not all(np.all(np.isfinite(t.u)) for t in trials):
        return None
    first = fit(scene, nominal, rounds=ROUNDS)
    told = _told(scene, judging, first, least=True)
    if told is not None and _heard_through(scene, told.fit.model):
        return told
    return _told(scene, judging, first, least=False)


def _told(scene: Scene, judging: Scene | None, first: Fit, least: bool) -> Dropouts | None:
    """What did not arrive beside the `first` fit, under the least noise or under noise as heard."""
    found, beside = first, scene
    for _ in range(PASSES):
        residuals = beside.residuals(found.model)
        if residuals is None:
            return None
        noise = least_noise(scene, found.model, residuals) if least else scene.noise
        search = _searched(replace(scene, noise=noise), found.model, RATES)
        if search is None or not search.found:
            return None
        beside = search.scene
        found = fit(beside, found.model, rounds=ROUNDS)
    assert search is not None  # there is a pass
    own = replace(search.scene, trials=scene.trials)
    left = own.residuals(found.model)
    if left is None:
        return None
    white = own.whiten(left)
    if judging is None:
        return Dropouts(found, search, None, False, white, np.zeros(0))
    judge = judged_by(judging.like(own), found)
    again = _searched(judge, found.model, (search.rate,))
    left = judge.residuals(found.model)
    if again is None or left is None:
        return None
    confirmed = AGAIN * again.promise > WORTH
    clear = search.gain > UNTOLD * WORTH and again.possible
    seldom = search.rate <= SELDOM and (clear or again.hints)
    agreed = again.found or (search.other <= 0.0 and again.agrees)
    if not (agreed if confirmed else seldom):
        return None  # slow forces and coloured noise are drawn by many samples a little
    return Dropouts(found, search, again, confirmed, white, judge.judge(left))


def _heard_through(scene: Scene, model: Model) -> bool:
    """Whether they bring `HINT` under the noise as it was heard, in all its colour, what was lost in it:
    least noise is white, and in a loop the command foretells what other noise does next. (Two machines
    with nothing missing, whose force noise had its corner at 15 and 27 Hz: 344 and 87 under least noise,
    -403 and 0.1 as heard; commands that were lost 36 to 727.)"""
    heard = _searched(scene, model, RATES)
    return heard is not None and heard.gain > HINT


@dataclass(frozen=True)
class _Look:
    """One recording: `seen` (N,), correlation of its whitened residual with a sample's trace; `power`: the
    trace's own with itself."""

    trial: Trial
    seen: Array
    power: Array

    def posterior(self, rate: float, sign: float, square: float) -> tuple[Array, Array, float]:
        """(probability, expected force of each sample (N,), log-likelihood gained) with noise of mean
        `square`."""
        odds = math.log(rate / (1.0 - rate))
        return _posteriors(
            self.trial.u, self.seen / square, self.power / square, odds, sign, SWEEPS
        )


def _searched(scene: Scene, model: Model, rates: Sequence[float]) -> Search | None:
    """At the most likely of the `rates`; None where the simulation leaves all bounds."""
    residuals = scene.residuals(model)
    if residuals is None:
        return None
    cuts = np.cumsum([len(t) for t in scene.trials])[:-1]
    white = scene.judge(residuals)
    pieces = np.split(white, cuts)
    looks = [
        _look(scene, whitener, trial, piece)
        for trial, whitener, piece in zip(scene.trials, scene.whiteners, pieces, strict=True)
    ]
    square = float(np.mean(white**2))

    def told(rate: float, share: float, sign: float = 1.0) -> float:
        brought = sum(look.posterior(rate, sign, share * square)[2] for look in looks)
        return brought - 0.5 * len(white) * (math.log(share) + 1.0 / share - 1.0)

    def best(sign: float) -> tuple[float, float, float]:
        """(log-likelihood gained, rate, share of the mean square that is noise)."""
        tried = [p for p in FIRST if p[0] in rates] or [(rates[0], 0.9)]
        gain, rate, share = max((told(*p, sign), *p) for p in tried)
        if (
            gain < -WORTH and len(rates) > 1
        ):  # of one rate it is told what it brings, however little
            return gain, rate, share
        for _ in range(TURNS):
            gain, share = max((told(rate, s, sign), s) for s in QUIETER)
            gain, rate = max((told(r, share, sign), r) for r in rates)
        return gain, rate, share

    gain, rate, share = best(1.0)
    other = best(-1.0)[0] if gain > WORTH else 0.0
    trials, lost = [], 0.0
    for look in looks:
        probable, force, _ = look.posterior(rate, 1.0, share * square)
        trials.append(_loaded(look.trial, force))
        lost += float(np.sum(probable))
    hoped, most = (promise(looks, p, share * square) for p in (rate, RATES[-1]))
    return Search(replace(scene, trials=tuple(trials)), rate, lost, gain, other, hoped, most)


def _look(scene: Scene, whitener: Whitener, trial: Trial, white: Array) -> _Look:
    trace = _trace(scene, whitener, len(trial))
    power = np.correlate(trace, trace, "full")[len(trace) - 1 :]
    seen = np.correlate(np.append(white, np.zeros(len(trace) - 1)), trace, "valid")
    return _Look(trial, seen, power)


def promise(looks: Sequence[_Look], rate: float, square: float) -> float:
    """Log-likelihood that lost samples bring in the mean, where this `rate` is lost: of each what tells it
    from its neighbours, and of all together what a delay of so many samples would bring."""
    hoped = 0.0
    for look in looks:
        d = -np.diff(look.trial.u, prepend=look.trial.u[:1])
        each = expected(0.5 * look.power[0] / square * d**2, rate)
        mean = rate * d
        both = np.concatenate([look.power[:0:-1], look.power])
        together = mean @ fftconvolve(mean, both)[len(look.power) - 1 :][: len(d)]
        hoped += float(np.sum(each)) + 0.5 * float(together) / square
    return hoped


def expected(worth: Array, rate: float) -> Array:
    """Log-likelihood that a sample of this `worth` m = d^2 P/2 (N,) brings in the mean: lost, its
    likelihood ratio is exp(m + sqrt(2 m) z) with z standard normal, else exp(-m + sqrt(2 m) z)."""
    z, weights = np.polynomial.hermite_e.hermegauss(41)
    m = np.geomspace(1e-6, 1e3, 400)[:, None]
    spread = np.sqrt(2.0 * m) * z
    share = weights / weights.sum()
    kept, gone = (
        np.logaddexp(math.log1p(-rate), math.log(rate) + side * m + spread) @ share
        for side in (-1.0, 1.0)
    )
    brought = rate * gone + (1.0 - rate) * kept
    return np.interp(np.log(np.maximum(worth, 1e-6)), np.log(m[:, 0]), np.maximum(brought, 0.0))


def _trace(scene: Scene, whitener: Whitener, n: int) -> Array:
    """What a unit force of one sample does to the whitened residual, as long as it lasts."""
    trace = trace_of_push(scene, whitener, 1, min(MEMORY, n))
    energy = np.cumsum(trace**2)
    return trace[: int(np.searchsorted(energy, ENERGY * energy[-1])) + 1]


def _loaded(trial: Trial, load: Array) -> Trial:
    return replace(trial, load=load if trial.load is None else trial.load + load)


@njit(cache=True, nogil=True, error_model="numpy")
def _posteriors(u, seen, power, odds, sign, sweeps):  # type: ignore[no-untyped-def]
    """(probability that each sample was lost, expected force, lower bound of the log-likelihood gained).

    `seen` (N,): correlation of the residual with a sample's trace; `power`: the trace's own. What the
    drive kept is followed by its mean."""
    n, reach = len(u), len(power)
    rate = 1.0 / (1.0 + np.exp(-odds))
    lost, force, left = np.full(n, rate), np.zeros(n), seen.copy()
    least = FAINT / np.sqrt(power[0])
    both = np.concatenate((power[:0:-1], power))
    for sweep in range(-1, sweeps):
        trust = min(1.0, (sweep + 1.0) / HEATED)
        kept = u[0]
        for k in range(1, n):
            d = sign * (kept - u[k])
            own = left[k] + force[k] * power[0]
            worth = d * own - 0.5 * d * d * power[0]
            lost[k] = 1.0 / (1.0 + np.exp(-(odds + trust * worth)))
            change = lost[k] * d - force[k]
            if abs(change) > least:
                first, end = max(0, k - reach + 1), min(n, k + reach)
                for j in range(end - first):  # one stride through both: in vector registers
                    left[first + j] -= change * both[first - k + reach - 1 + j]
                force[k] += change
            kept = lost[k] * kept + (1.0 - lost[k]) * u[k]
    gain, kept = 0.0, u[0]
    for k in range(1, n):
        p, d = lost[k], kept - u[k]
        gain += 0.5 * force[k] * (seen[k] + left[k]) - 0.5 * d * d * p * (1.0 - p) * power[0]
        if p > 0.0:
            gain -= p * np.log(p / rate)
        if p < 1.0:
            gain -= (1.0 - p) * np.log((1.0 - p) / (1.0 - rate))
        kept = p * kept + (1.0 - p) * u[k]
    return lost, force, gain
