"""One hypothesis judged: fitted with the noise it leaves itself, and run on held-out recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft
import scipy.stats

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import NAMES, netted, undone
from ffl.diagnose.hypothesis.fit import Fit, fit, surprise
from ffl.diagnose.hypothesis.knots import continued
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.doubt import Doubt, judged_by
from ffl.diagnose.noise.lost import mean_power
from ffl.diagnose.noise.noise import Paths
from ffl.diagnose.noise.spread import spread
from ffl.diagnose.recorded.commands import lets_through
from ffl.diagnose.recorded.starts import with_clocks, with_starts
from ffl.diagnose.recorded.trials import extent
from ffl.effects import EFFECTS
from ffl.effects.motion import Extent
from ffl.systems.state_space import Array

PER_NUMBER = 4.0  # log-likelihood that one more free number must bring (BIC: half of log N)
QUIET = 0.35  # quantile over segments and bins that noise is read from: physics is not everywhere
PASSES = 4  # most changes of noise while one hypothesis is fitted
BINS = 4096  # frequencies over which noise is summed up
LIGHT = -0.4  # of the mass: no engineer's is so far off
OTHER = -0.75  # of the mass: what is left is another machine (a throttle without 90 % of its own)
OPEN = 4.0  # log-likelihood of the fitted recordings by which corrections are as good as others
WANDERED = 4.0  # surprise of its corrections by which a fit ends beyond where it began
MISLED = 4.0  # log-likelihood, each in its own noise, that a fit may have lost on its way
CLEANER = 0.85  # noise must fall below this share of what it was for another pass


@dataclass(frozen=True, eq=False)
class Judged:
    """A fitted hypothesis with its own noise: `fitted` and `held_out` log-likelihoods."""

    fit: Fit
    scene: Scene
    fitted: float
    held_out: float
    held_white: Array
    held: Scene | None = None
    predicted: bool = False  # by what is left from sample to sample: no two free runs agree
    price: float | None = None  # what its numbers cost; PER_NUMBER each where none is given

    @property
    def model(self) -> Model:
        return self.fit.model

    @property
    def freedom(self) -> int:
        return self.fit.freedom

    @cached_property
    def spread(self) -> Array:
        """Standard deviations of theta, as far as what is left is not white."""
        return spread(self.fit, [len(trial) for trial in self.scene.trials])

    @cached_property
    def independent(self) -> float:
        """Samples that the held-out residual is worth."""
        return effective(self.held_white) if len(self.held_white) else 0.0

    @property
    def score(self) -> float:
        price = PER_NUMBER * self.freedom if self.price is None else self.price
        return self.fitted + self.held_out - price - self.fit.surprise

    @property
    def name(self) -> str:
        return " + ".join(self.model.names) or "nothing"


def judge(
    scene: Scene, held: Scene | None, model: Model, rounds: int = 10, like: Fit | None = None
) -> Judged:
    """Fits `model` under the scene's noise, then under its own, and scores it. The corrections'
    columns of the fit it is `like` save differences."""
    scene = with_clocks(scene, model, 1)
    known = None if like is None else like.shared(model)
    first = fit(scene, model, rounds=rounds, known=known)
    if scene.free_clocks and "drift" in first.model.names and first.status != "diverged":
        # What each recording shows goes with both numbers.
        scene = with_clocks(scene, first.model, 1)
        first = fit(scene, first.model, rounds=rounds, known=first.known())
    if held is not None and held.free_clocks and first.status != "diverged":
        held = with_clocks(held.like(scene), first.model, 0)
    if first.status != "diverged" and (begun := with_starts(scene, first.model, 1)) is not scene:
        # A start estimated without this physics speaks against it: each rival has its own.
        scene = begun
        first = fit(scene, first.model, rounds=rounds, known=first.known())
    if held is not None and first.status != "diverged":
        held = with_starts(held.like(scene), first.model, 1)
    quieter, quieter_sensor = scene.noise.force, scene.noise.sensor
    if first.status == "diverged" or not np.isfinite(first.cost):
        return Judged(first, scene, -np.inf, -np.inf, np.zeros(0))
    fitted_on = scene
    for _ in range(PASSES):  # physics that has been found no longer counts as noise
        cleaner = scene.with_noise_of(
            raw_residuals(scene, first.model), coloured=False, quantile=QUIET
        )
        if min(cleaner.noise.force / quieter, cleaner.noise.sensor / quieter_sensor) > CLEANER:
            break
        quieter, quieter_sensor = cleaner.noise.force, cleaner.noise.sensor
        first = fit(cleaner, first.model, rounds=max(4, rounds // 2), known=first.known())
        fitted_on = cleaner
    first = continued(first, fitted_on)
    # Fitted under the least noise, scored under the noise it leaves: coloured noise in the fit would
    # let slow physics go as noise, and its absence in the score would take noise for physics. Its size is
    # free: read from the calm stretches alone, less noise there spoke against who left less everywhere
    # (a gain that depends on position beside friction: 45,800 nats against the truth).
    own, fitted = by_its_noise(scene, first.model)
    if first.surprise > surprise(model) + WANDERED:
        other = _as_it_began(scene, fitted_on, model, fitted, rounds)
        first, own, fitted = other or (first, own, fitted)
    return Judged(first, own, fitted, *held_out(held, scene, first), held)


def by_its_noise(scene: Scene, model: Model) -> tuple[Scene, float]:
    """(The scene with the noise that `model` leaves, log-likelihood in that)."""
    residuals = raw_residuals(scene, model)
    own = scene.with_noise_of(residuals)
    return own, own.likeliest(own.whiten(residuals))


def _as_it_began(
    scene: Scene, fitted_on: Scene, model: Model, fitted: float, rounds: int
) -> tuple[Fit, Scene, float] | None:
    """(Fit, the scene with the noise it leaves, log-likelihood in that) of `model` under the coloured noise
    that it leaves where it begins; None where that is no likelier than the fit that reached `fitted`. Under
    the least white noise slow noise speaks for whoever moves less. (A limit that half of the commands
    reached, in noise as large, began 351 ahead of nothing and ended 71 ahead, at a fifth of the limit
    and 69 % less mass.)"""
    begun, likelihood = by_its_noise(scene, model)
    if not likelihood > fitted + MISLED:
        return None
    there = fit(begun, model, rounds=rounds).model
    own, reached = by_its_noise(scene, there)
    return (fit(fitted_on, there, rounds=0), own, reached) if reached > fitted else None


def granted(base: Judged, rival: Judged, quiet: Scene) -> Judged:
    """`base` as the corrections of `rival` have it without its last effect, where the fitted
    recordings leave these open and the held-out ones prefer them: what they gain there is not the
    effect's. (A null: the damping of a mode that only the judging multisine excites, 205 nats.)"""
    plain = rival.model.without(len(rival.model.effects) - 1)
    if base.held is None or plain.names != base.model.names:
        return base
    if not 0.5 * quiet.worth * (quiet.cost(plain) - quiet.cost(base.model)) <= OPEN:
        return base
    worth, held_white = held_out(base.held, quiet, replace(base.fit, model=plain))
    other = replace(base, held_out=worth, held_white=held_white)
    level, own = levelled([other, base])
    return other if level.held_out > own.held_out else base


def raw_residuals(scene: Scene, model: Model) -> list[Array]:
    residuals = scene.residuals(model)
    return residuals if residuals is not None else [np.full(len(t), 1e3) for t in scene.trials]


def held_out(held: Scene | None, scene: Scene, fitted: Fit) -> tuple[float, Array]:
    """(log-likelihood, whitened residual) of recordings that nothing was fitted to.

    All rivals of a round are whitened alike and the scale is free, -n/2 log(mean square) with n the
    effective number of samples: a held-out recording that shows something of its own (a faster
    edge, say) must not make every better model look worse because its noise is smaller. Nor must
    chance in corrections that the fitted recordings leave open (`doubt`).
    """
    if held is None or not held.trials:
        return 0.0, np.zeros(0)
    judged = judged_by(held.like(scene), fitted)
    residuals = judged.residuals(fitted.model)
    if residuals is None:
        return -np.inf, np.zeros(0)
    white = judged.judge(residuals)
    return -0.5 * effective(white) * float(np.log(mean_power(white))), white


def between(quiet: Scene, current: Judged, rivals: Sequence[Judged]) -> list[Judged]:
    """`rivals`, those of as many numbers as `current` with what held-out recordings say between the two
    once each is granted what the fitted ones leave open in all its numbers, as far as a run with them bears
    it out. (A lag lost 425 nats to a delay where both fitted alike: its time constant, 1.3 % off, made five
    times the noise there.) Who has more numbers would be granted more, and wins by that; nor does a grant
    say more for who is ahead already. (A delay beside 17 levels of friction by position was 4 nats ahead of
    a lag, and 33 behind with both granted all of them.)"""
    if current.held is None or all(r.freedom != current.freedom for r in rivals):
        return list(rivals)
    own = _at_its_best(quiet, current)
    out = []
    for rival in rivals:
        alike = own is not None and rival.held is not None and rival.freedom == current.freedom
        best = _at_its_best(quiet, rival) if alike else None
        if own is not None and best is not None:
            one, other = levelled([own, best])
            ahead, was = other.held_out - one.held_out, rival.held_out - current.held_out
            if ahead * was < 0.0 or abs(ahead) < abs(was):
                rival = replace(rival, held_out=current.held_out + ahead)
        out.append(rival)
    return out


def _at_its_best(quiet: Scene, judged: Judged) -> Judged | None:
    """`judged` on its held-out recordings with its numbers where these have them, within the posterior."""
    assert judged.held is not None
    held = judged.held.like(quiet)
    doubt = Doubt.of(held, judged.fit, ("correction", "effect"))
    left = held.residuals(judged.model)
    if doubt is None or left is None:
        return None
    white, theta = held.whiten(left), judged.model.theta.copy()
    j = held.whiten_stacked(doubt.columns)
    if np.all(np.isfinite(j)):
        theta[list(doubt.chosen)] += doubt.step(j, white)
        there = held.residuals(judged.model.at(theta))
        best = white if there is None else held.whiten(there)
        white = min(white, best, key=lambda e: float(e @ e))
    return replace(judged, held_white=white)


def effective(white: Array, lags: int = 200) -> float:
    """Independent samples that a residual with this correlation is worth in its sum of squares."""
    lags = min(lags, len(white) // 4)
    n = scipy.fft.next_fast_len(len(white) + lags, real=True)
    r = scipy.fft.irfft(np.abs(scipy.fft.rfft(white, n)) ** 2, n)[: lags + 1]
    rho = r[1:] / max(r[0], 1e-300)
    return len(white) / (1.0 + 2.0 * float(np.sum(rho**2)))


def levelled(judged: Sequence[Judged]) -> list[Judged]:
    """The same with the held-out recordings worth equally many independent samples to all of them.

    A model that is far off leaves a slow residual, few independent samples, and would pass for
    hardly worse than one that leaves noise: the sharpest of those compared says how many there are.
    """
    n = max((j.independent for j in judged if len(j.held_white)), default=0.0)
    out = []
    for j in judged:
        known = len(j.held_white) and np.isfinite(j.held_out)
        worth = -0.5 * n * float(np.log(mean_power(j.held_white))) if known else j.held_out
        other = replace(j, held_out=worth)
        object.__setattr__(other, "independent", j.independent)  # of the same residual
        out.append(other)
    return out


def whitened_alike(judged: Sequence[Judged]) -> list[Judged]:
    """`levelled`, the held-out recordings whitened for all as for the one under whose noise least passes
    for noise: who was judged under louder noise than the others seems to leave less. (A spring and a load
    that left 100 times the noise stood 11,106 ahead of a spring that left as much.)"""
    heard = [j.held for j in judged if j.held is not None]
    left = heard[0].residuals(judged[0].model) if len(heard) == len(judged) else None
    if left is None or all(held.noise == heard[0].noise for held in heard):
        return levelled(judged)
    told = [mean_power(heard[0].like(held).whiten(left)) for held in heard]
    quietest = heard[int(np.argmax(told))]
    out = []
    for j in judged:
        worth, held_white = held_out(j.held, quietest, j.fit)
        out.append(replace(j, held_out=worth, held_white=held_white))
    return levelled(out)


def charged(rival: Judged, base: Judged) -> float:
    """Log-likelihood of the fitted recordings that `rival` brings over `base`, its numbers charged."""
    return rival.fitted - base.fitted - PER_NUMBER * (rival.freedom - base.freedom)


def likeliest(judged: Sequence[Judged]) -> Judged:
    """The one that scores highest, with what they are judged on worth equally many samples to all. (What
    leaves a slow residual has few by its own count, and little to lose: a mass at the wrong end.)"""
    return max(levelled(judged), key=lambda j: j.score)


def best_against(tried: Sequence[Judged], current: Judged) -> tuple[Judged, float] | None:
    """(The likeliest credible one of `tried`, its score over that of `current`); None where none is."""
    sound = [one for one in tried if credible(one)]
    if not sound:
        return None
    best = likeliest(sound)
    ahead, stands = levelled([best, current])
    return best, ahead.score - stands.score


def raw_error(held: Scene | None, model: Model) -> float:
    """Sum of squares of the held-out free-running error, not whitened."""
    if held is None or not held.trials:
        return 1.0
    residuals = held.residuals(model)
    if residuals is None:
        return np.inf
    return float(sum(np.sum(e**2) for e in residuals))


def noise_error(held: Scene | None, judged: Scene, chance: float = 0.5) -> float:
    """What noise as `judged` sees it makes of `raw_error` with this `chance` of more: slow noise is a few
    large numbers, and may make much more than in the mean."""
    if held is None:
        return 0.0
    step = held.loop.system.sample_time
    frequencies = (np.arange(BINS) + 0.5) / BINS * 0.5 / step
    density = judged.noise.density(Paths.of(held.loop, frequencies))
    mean = float(np.mean(density))
    numbers = held.samples * mean**2 / float(np.mean(density**2))
    return held.samples * mean * float(scipy.stats.chi2.isf(chance, numbers)) / numbers


def mean_square(judged: Judged) -> float:
    """Of the whitened held-out residual; 1 where there is none."""
    return mean_power(judged.held_white) if len(judged.held_white) else 1.0


def credible(judged: Judged) -> bool:
    """Whether every effect has numbers of the physics that it is named for, beside a machine that is still
    the stated one, and none is undone by the model's own number of its kind. (A damper at the motor that
    took the place of half the machine's own was a delay of half a sample; dropped in the end as no effect,
    it left nobody in its place.)"""
    if not np.isfinite(judged.score):
        return False  # it ran away, or no machine has such numbers
    model = judged.model
    if not all(EFFECTS[e.name].credible(e, _reach(judged)) for e in model.effects):
        return False
    if not all(lets_through(e, model.base.passing) for e in model.effects):
        return False
    if starved(model) or undone(model) or (model.effects and is_another(model)):
        return False
    return all(netted(judged.scene, model, name) is None for name in NAMES)


def _reach(judged: Judged) -> Extent:
    base = judged.model.base
    return extent(judged.scene.trials, base.travel, base.plant.output_unit)


def is_another(model: Model) -> bool:
    """A fraction of the stated mass; where the linear part was identified from the physics that it has to
    stand beside, it may be that far off (two coupled drives, seen through folds)."""
    return not model.base.plant.is_identified and model.corrections.get("mass", 0.0) < OTHER


def starved(model: Model) -> bool:
    """A drive that holds most of the command back from a machine of a fraction of its mass: that explains
    any force that takes the command up. (A spring, friction and a limit of 3.1 A on a steering bench: 0.1 A
    and 65 % less mass.)"""
    bent = any(EFFECTS[e.name].bends for e in model.effects)
    return bent and model.corrections.get("mass", 0.0) < LIGHT
