"""Commands that did not arrive: a bus that loses a packet leaves the drive with what it had.

At a lost sample the drive differs from the command by a[k-1] - u[k], a being what it really got:
a force that is known in size and sign, at samples that are not. No map of the motion has it, and in
the mean it passes for a delay of as many samples as the share that is lost. Here the samples are
found one by one, best first, by what the force does to the whitened residual; the same search for
forces of the other sign, which nothing makes, says what noise alone would give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.special
from numba import njit

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.freeform import held_gain, least_noise
from ffl.diagnose.noise.doubt import judged_by
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

CERTAIN = 6.0  # log-likelihood that a sample must bring: one in four hundred is lost
WORTH = 40.0  # log-likelihood that all samples must bring beyond `CERTAIN` each
# Of it that forces of the other sign may reach: where commands change sign from sample to sample they
# are another sample's and reach 0.28 of it.
ALIKE = 0.5
MOST = 0.5  # of the samples that could be seen to be lost: more is a delay
AGAIN = 0.3  # of what is to be expected of recordings that judge, from which they are asked
ENERGY = 0.999  # of what one sample does to the residual, from which its length is taken
MEMORY = 2048  # samples of it at most
PASSES = 2  # once found, the model's own numbers no longer stand in for them
ROUNDS = 6


@dataclass(frozen=True)
class Search:
    """`scene` with what the lost samples are worth as loads; `lost` samples of the `able` ones, those that
    would bring more than `CERTAIN` in the mean; log-likelihood that they bring beyond it, that those
    of the other sign would, and `promise`: that all samples would in the mean, had they been lost."""

    scene: Scene
    lost: int
    able: float
    gain: float
    other: float
    promise: float

    @property
    def found(self) -> bool:
        return self.gain > WORTH and self.other < ALIKE * self.gain

    @property
    def few(self) -> bool:
        """No more of each than its own force."""
        return self.gain < self.promise

    @property
    def rate(self) -> float:
        return self.lost / max(self.able, 1.0)


@dataclass(frozen=True)
class Dropouts:
    """`fit` of the model without effects beside what was lost, in the recordings that were fitted and
    those that judge; `confirmed`: these had to show it and did; `white`, `held_white`: whitened
    residuals, under the noise of `fitted`."""

    fit: Fit
    fitted: Search
    held: Search | None
    confirmed: bool
    white: Array
    held_white: Array

    def gains(self, scene: Scene, held: Scene | None, standing: Model) -> tuple[float, float]:
        """(fitted, held out) log-likelihood over what `standing` leaves of the recordings as they
        are, less what it costs to say which samples were lost."""
        rivals = [(scene, self.white, self.fitted)]
        if held is not None and self.held is not None:
            rivals.append((held, self.held_white, self.held))
        out = []
        for ground, white, search in rivals:
            quiet = ground.like(self.fitted.scene)
            left = quiet.residuals(standing)
            everything = np.ones(len(white), bool)
            gained = np.inf if left is None else held_gain(quiet.judge(left), white, everything)
            out.append(gained - CERTAIN * search.lost)
        return out[0], out[-1]


def dropouts(scene: Scene, held: Scene | None, nominal: Model) -> Dropouts | None:
    """What did not arrive; None where there is no sign of it, or commands were not recorded."""
    judging = held if held is not None and held.trials else None
    trials = [*scene.trials, *(judging.trials if judging else ())]
    if scene.observed or not all(np.all(np.isfinite(t.u)) for t in trials):
        return None
    model, search = nominal, Search(scene, 0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(PASSES):
        found = fit(search.scene, model, rounds=ROUNDS)
        model = found.model
        residuals = search.scene.residuals(model)
        if residuals is None:
            return None
        noise = least_noise(scene, model, residuals)
        search = _searched(replace(scene, noise=noise), model, MOST)
        if search is None or not search.found or not search.few:
            return None
    found = fit(search.scene, model, rounds=ROUNDS)
    left = search.scene.residuals(found.model)
    if left is None:
        return None
    white = search.scene.whiten(left)
    if judging is None:
        return Dropouts(found, search, None, False, white, np.zeros(0))
    again = _searched(judged_by(judging.like(search.scene), found), found.model)
    if again is None:
        return None
    # Where commands change sign from sample to sample, the other sign is another sample's: it does
    # much as well, but not all.
    confirmed = AGAIN * search.rate * again.promise > WORTH
    if confirmed and again.gain - again.other < WORTH:
        return None
    left = again.scene.residuals(found.model)
    if left is None:
        return None
    return Dropouts(found, search, again, confirmed, white, again.scene.judge(left))


def _searched(scene: Scene, model: Model, most: float = np.inf) -> Search | None:
    """None where the simulation leaves all bounds, or more than the share `most` of the samples that could
    be seen to be lost would have to be."""
    residuals = scene.residuals(model)
    if residuals is None:
        return None
    cuts = np.cumsum([len(t) for t in scene.trials])[:-1]
    pieces = np.split(scene.judge(residuals), cuts)
    looks = []
    for trial, whitener, white in zip(scene.trials, scene.whiteners, pieces, strict=True):
        trace = _trace(scene, whitener, len(trial))
        power = np.correlate(trace, trace, "full")[len(trace) - 1 :]
        seen = np.correlate(np.append(white, np.zeros(len(trace) - 1)), trace, "valid")
        looks.append((trial, seen, power))
    hopes = [expected(0.5 * power[0] * np.diff(trial.u) ** 2) for trial, _, power in looks]
    able, promise = (sum(numbers) for numbers in zip(*hopes, strict=True))
    room = most * max(able, 1.0)
    trials, count, gain, other = [], 0, 0.0, 0.0
    for trial, seen, power in looks:
        lost, brought = _pursued(trial.u, seen.copy(), power, CERTAIN, 1.0, room - count)
        count, gain = count + int(np.sum(lost)), gain + brought
        if count >= room:
            return None
        trials.append(_loaded(trial, lost))
    if gain > WORTH:
        other = sum(
            _pursued(t.u, seen, power, CERTAIN, -1.0, np.inf)[1] for t, seen, power in looks
        )
    return Search(replace(scene, trials=tuple(trials)), count, able, gain, other, promise)


def expected(worth: Array) -> tuple[float, float]:
    """(samples that bring more than `CERTAIN`, log-likelihood that these bring beyond it), in the mean, had
    all been lost. A sample's force of this `worth` (N,), m = power d^2/2, brings m + sqrt(2 m) times a
    standard normal number: of many faint ones some are seen by the luck of the noise."""
    m = np.maximum(worth, 1e-300)
    spread = np.sqrt(2.0 * m)
    above = (m - CERTAIN) / spread
    seen = scipy.special.ndtr(above)
    beyond = (m - CERTAIN) * seen + spread * np.exp(-0.5 * above**2) / np.sqrt(2.0 * np.pi)
    return float(np.sum(seen)), float(np.sum(np.maximum(beyond, 0.0)))


def _trace(scene: Scene, whitener: Whitener, n: int) -> Array:
    """What a unit force of one sample does to the whitened residual, as long as it lasts."""
    unit = np.zeros(min(MEMORY, n))
    unit[0] = 1.0
    steady = whitener.steady
    trace = steady(np.atleast_1d(scene.loop.process_sensitivity.filter(unit)))
    energy = np.cumsum(trace**2)
    return trace[: int(np.searchsorted(energy, ENERGY * energy[-1])) + 1]


def _loaded(trial: Trial, lost: Array) -> Trial:
    kept = np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost))))
    load = trial.u[kept] - trial.u
    return replace(trial, load=load if trial.load is None else trial.load + load)


@njit(cache=True, nogil=True)
def _pursued(u, seen, power, certain, sign, most):  # type: ignore[no-untyped-def]
    """Lost samples, best first until `most`, and the sum of what each brings beyond `certain`. `seen` (N,):
    correlation of the residual with a sample's trace, changed on the way; `power`: the trace's own.
    Of neighbours the earlier may be found later: what the drive kept then changes for both."""
    n, reach = len(u), len(power)
    lost = np.zeros(n, np.bool_)
    applied = u.copy()
    brought = 0.0
    for done in range(n):
        if done >= most:
            break
        best, at = certain, -1
        for k in range(1, n):
            if not lost[k]:
                d = sign * (applied[k - 1] - u[k])
                gain = d * seen[k] - 0.5 * d * d * power[0]
                if gain > best:
                    best, at = gain, k
        if at < 0:
            break
        brought += best - certain
        lost[at] = True
        k = at
        while k < n and lost[k]:
            change = sign * (applied[k - 1] - applied[k])
            applied[k] = applied[k - 1]
            for j in range(max(0, k - reach + 1), min(n, k + reach)):
                seen[j] -= change * power[abs(j - k)]
            k += 1
    return lost, brought
