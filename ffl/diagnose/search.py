"""The contest: every effect at every place against every other, judged by likelihood.

Each hypothesis is fitted with the noise it leaves itself (so that neither coloured noise passes for
physics nor physics for coloured noise), and scored by
    log-likelihood of the fitted recordings - penalty per free number + log-likelihood of the
    held-out recordings,
the second a free-running simulation with nothing fitted to it. One effect is added at a time; before
a second one is thought of, all siblings of the first have been fitted too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.fit import Fit, Scene, fit
from ffl.diagnose.model import Model
from ffl.diagnose.screen import Candidate, Screen
from ffl.diagnose.starts import with_clocks, with_starts
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PER_NUMBER = (
    4.0  # log-likelihood that one more free number must bring (BIC: half log of N, N ~ 3000)
)
SHORTLIST = 6
FAINT = 16.0  # first-order gain below which a fit is not worth while
QUIET = 0.35  # quantile over segments and bins that noise is read from: physics is not everywhere
MOST_KNOTS = 33
SHARE = 0.004  # of the number of samples: log-likelihood that a further effect must bring
WORSE = 1.2  # held-out sum of squares that one more effect may cost at most, of what it was
PASSES = 4  # most changes of noise while one hypothesis is fitted
CLEANER = 0.85  # noise must fall below this share of what it was for another pass
LEAST = 8.0  # of it in the fitted recordings; the held-out ones may lose half of this
KEEP = 20.0  # score an effect must be worth beside all others
SUBSTITUTE = 3.0  # score by which a sibling must be better
WORTH_A_FIT = 0.15  # of the best first-order gain


@dataclass(frozen=True)
class Judged:
    """A fitted hypothesis with its own noise: `fitted` and `held_out` log-likelihoods."""

    fit: Fit
    scene: Scene
    fitted: float
    held_out: float
    held_white: Array
    held: Scene | None = None

    @property
    def model(self) -> Model:
        return self.fit.model

    @property
    def freedom(self) -> int:
        return int(np.sum(np.linalg.norm(self.fit.jacobian, axis=0) > 0))

    @property
    def score(self) -> float:
        return self.fitted + self.held_out - PER_NUMBER * self.freedom - self.fit.surprise

    @property
    def name(self) -> str:
        return " + ".join(self.model.names) or "nothing"


def judge(
    scene: Scene, held: Scene | None, model: Model, rounds: int = 10, like: Fit | None = None
) -> Judged:
    """Fits `model` under the scene's noise, then under its own, and scores it. The corrections'
    columns of the fit it is `like` save differences."""
    scene = with_clocks(scene, model, 1)
    known = None if like is None else like.known(("correction", "given"))
    first = fit(scene, model, rounds=rounds, known=known)
    if held is not None and held.free_clocks and first.status != "diverged":
        held = with_clocks(replace(held, noise=scene.noise), first.model, 0)
    quieter, quieter_sensor = scene.noise.force, scene.noise.sensor
    if first.status == "diverged":
        return Judged(first, scene, -np.inf, -np.inf, np.zeros(0))
    for _ in range(PASSES):  # physics that has been found no longer counts as noise
        cleaner = scene.with_noise_of(_raw(scene, first.model), coloured=False, quantile=QUIET)
        if min(cleaner.noise.force / quieter, cleaner.noise.sensor / quieter_sensor) > CLEANER:
            break
        quieter, quieter_sensor = cleaner.noise.force, cleaner.noise.sensor
        first = fit(cleaner, first.model, rounds=max(4, rounds // 2), known=first.known())
    # Fitted under the least noise, scored under the noise it leaves: coloured noise in the fit would
    # let slow physics go as noise, and its absence in the score would take noise for physics.
    residuals = _raw(scene, first.model)
    own = scene.with_noise_of(residuals)
    white = own.whiten(residuals)
    return Judged(first, own, own.log_likelihood(white), *held_out(held, scene, first.model), held)


def _raw(scene: Scene, model: Model) -> list[Array]:
    residuals = scene.residuals(model)
    return residuals if residuals is not None else [np.full(len(t), 1e3) for t in scene.trials]


def held_out(held: Scene | None, scene: Scene, model: Model) -> tuple[float, Array]:
    """(log-likelihood, whitened residual) of recordings that nothing was fitted to.

    All rivals of a round are whitened alike and the scale is free, -n/2 log(mean square) with n the
    effective number of samples: a held-out recording that shows something of its own (a faster
    edge, say) must not make every better model look worse because its noise is smaller.
    """
    if held is None or not held.trials:
        return 0.0, np.zeros(0)
    judged = replace(held, noise=scene.noise)
    residuals = judged.residuals(model)
    if residuals is None:
        return -np.inf, np.zeros(0)
    white = judged.whiten(residuals)
    return -0.5 * effective(white) * float(np.log(np.mean(white**2))), white


def effective(white: Array, lags: int = 200) -> float:
    """Independent samples that a residual with this correlation is worth in its sum of squares."""
    lags = min(lags, len(white) // 4)
    power = np.abs(np.fft.rfft(white, 2 * len(white))) ** 2
    r = np.fft.irfft(power)[: lags + 1]
    rho = r[1:] / max(r[0], 1e-300)
    return len(white) / (1.0 + 2.0 * float(np.sum(rho**2)))


@dataclass(frozen=True)
class Step:
    """One round of the contest: what stood, who challenged it, what they reached."""

    before: Judged
    screened: tuple[Candidate, ...]
    rivals: tuple[Judged, ...]
    accepted: Judged | None


def shortlist(candidates: Sequence[Candidate], depth: int = SHORTLIST) -> list[Candidate]:
    """Who is worth a full fit: the best of the screen, one place per effect, and their siblings."""
    if not candidates:
        return []
    best: dict[str, Candidate] = {}
    for c in candidates:
        best.setdefault(c.spec.name, c)
    ranked = sorted(best.values(), key=lambda c: -(c.gain - 2 * PER_NUMBER * c.freedom))
    top = ranked[0].gain
    chosen = [c for c in ranked[:depth] if c.gain > WORTH_A_FIT * top]
    names = {c.spec.name for c in chosen}
    for c in list(chosen[:2]):  # the same physics at another point of the machine
        elsewhere = [o for o in candidates if o.spec.name == c.spec.name and o is not c]
        chosen += [o for o in elsewhere if o.gain > 0.4 * c.gain]
    for c in ranked[:2]:
        for sibling in EFFECTS[c.spec.name].siblings:
            if sibling in best and sibling not in names and best[sibling].gain > 0.02 * top:
                chosen.append(best[sibling])
                names.add(sibling)
    return chosen


def contest(
    scene: Scene,
    held: Scene | None,
    model: Model,
    threshold: float,
    most: int = 3,
    progress: Callable[[str], None] | None = None,
) -> tuple[Judged, list[Step], Scene | None]:
    """Forward selection with substitution; what stands at the end, all rounds, and the held-out
    recordings with their starts."""
    say = progress or (lambda line: None)
    standing = judge(scene, held, model)
    steps: list[Step] = []
    last_error = np.inf
    while True:
        # White noise no louder than what is left: slow physics must not pass for slow noise.
        quiet = scene.with_noise_of(_raw(scene, standing.model), coloured=False, quantile=QUIET)
        scene, quiet = with_starts(scene, standing.model), with_starts(quiet, standing.model)
        if held is not None:
            held = with_starts(replace(held, noise=quiet.noise), standing.model)
        base = judge(quiet, held, standing.model, rounds=6)
        say(f"{base.name}: log-likelihood {base.fitted:.1f}, held out {base.held_out:.1f}")
        base = refined(quiet, held, base, say)
        if base.model.effects:
            base = settle(quiet, held, base, say)
        error = raw_error(held, base.model)
        if steps and error > WORSE * last_error:
            # What came in last does not hold up on the held-out recordings once all is refitted.
            say(
                f"  turned down again: held-out error {np.sqrt(error / last_error):.2f} times as large"
            )
            steps[-1] = replace(steps[-1], accepted=None)
            return steps[-1].before, steps, held
        last_error = error
        if len(steps) == most:
            return base, steps, held
        screened = Screen(quiet, base.fit).candidates()
        rivals = []
        least = (
            FAINT if steps else FAINT / 2
        )  # what hides in the noise of the first round may be faint
        taken = _excluded(base.model)
        if scene.free_clocks:  # a slow force cannot be carried from one unknown clock to another
            taken.add("drift")
        fresh = [c for c in screened if c.spec.name not in taken and c.gain > least]
        for c in shortlist(fresh):
            rival = judge(quiet, held, with_best_start(quiet, base.model, c.spec), 6, base.fit)
            say(
                f"  {rival.name}: {rival.fitted - base.fitted:+.1f} fitted, "
                f"{rival.held_out - base.held_out:+.1f} held out"
            )
            rivals.append(rival)
        rivals.sort(key=lambda j: -j.score)
        for k, rival in enumerate(rivals[:2]):  # the two that matter go on to convergence
            if rival.score > base.score and rival.fit.status == "rounds":
                rivals[k] = judge(quiet, held, rival.model, 8, rival.fit)
        rivals.sort(key=lambda j: -j.score)
        worthy = [r for r in rivals if _earns(r, base, threshold)]
        accepted = worthy[0] if worthy else None
        steps.append(Step(base, tuple(screened), tuple(rivals), accepted))
        if accepted is None:
            return base, steps, held
        standing = accepted
        scene = replace(scene, trials=accepted.scene.trials)  # with the clocks it settled on
        held = accepted.held


LADDERS = {  # where the cost is not convex: the parameter, and factors on what the screen proposes
    "backlash": ("gap", np.geomspace(0.02, 50.0, 16)),
    "presliding_friction": ("stiffness", np.geomspace(0.05, 20.0, 7)),
    "hysteresis": ("displacement", np.geomspace(0.2, 5.0, 5)),
    "saturation": ("limit", np.linspace(0.8, 1.2, 15)),
    "sensor_nonlinearity": ("level", np.linspace(0.93, 1.07, 15)),
    "dead_zone": ("half_width", np.geomspace(0.3, 3.0, 6)),
    "flexible_mode": ("mass_fraction", np.geomspace(0.2, 5.0, 5)),
}


def with_best_start(scene: Scene, model: Model, spec: EffectSpec) -> Model:
    """`model` with the effect, its decisive parameter at the best rung of a ladder of simulations."""
    rungs = [model.with_effect(spec)]
    if spec.name in LADDERS:
        name, factors = LADDERS[spec.name]
        effect = EFFECTS[spec.name].parameter(name)
        for factor in factors:
            value = float(np.clip(spec.parameters[name] * factor, effect.lower, effect.upper))
            rungs.append(
                model.with_effect(replace(spec, parameters={**spec.parameters, name: value}))
            )
    # Corrections that stood in for the effect would stand in its way: start from nominal ones too.
    nominal = {k: v for k, v in model.corrections.items() if k in model.held}
    rungs += [replace(rung, corrections=nominal) for rung in rungs]
    costs = []
    for rung in rungs:
        residuals = scene.residuals(rung)
        white = None if residuals is None else scene.whiten(residuals)
        costs.append(np.inf if white is None else float(white @ white))
    return rungs[int(np.argmin(costs))]


DRY = frozenset(  # forms of one and the same friction: rivals, never company
    {
        "coulomb_friction",
        "asymmetric_friction",
        "stribeck_friction",
        "presliding_friction",
        "hysteresis",
        "position_dependent_friction",
    }
)


def raw_error(held: Scene | None, model: Model) -> float:
    """Sum of squares of the held-out free-running error, not whitened."""
    if held is None or not held.trials:
        return 1.0
    residuals = held.residuals(model)
    if residuals is None:
        return np.inf
    return float(sum(np.sum(e**2) for e in residuals))


def _excluded(model: Model) -> set[str]:
    """Effects that cannot be added: those there, and other forms of the dry friction there."""
    names = {spec.name for spec in model.acting}
    return names | (DRY if names & DRY else set())


def refined(quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]) -> Judged:
    """`judged` with twice the knots in its friction table, as long as that pays."""
    name = "position_dependent_friction"
    current = judged
    while name in current.model.names:
        index = current.model.names.index(name)
        spec = current.model.effects[index]
        table = spec.parameters["table"]
        grid = np.linspace(table["grid"][0], table["grid"][-1], 2 * len(table["grid"]) - 1)
        if len(grid) > MOST_KNOTS:
            break
        finer = {"grid": grid.tolist()}
        for key in ("positive", "negative"):
            finer[key] = np.interp(grid, table["grid"], table[key]).tolist()
        level = float(np.mean([finer["positive"], finer["negative"]]))
        effects = list(current.model.effects)
        effects[index] = replace(spec, parameters={"table": finer, "level": level})
        other = judge(quiet, held, replace(current.model, effects=tuple(effects)), 4, current.fit)
        say(f"  {len(grid)} knots: {other.score - current.score:+.1f}")
        if other.score < current.score + SUBSTITUTE:
            break
        current = other
    return current


def _earns(rival: Judged, base: Judged, threshold: float) -> bool:
    """Enough together, and in the fitted and the held-out recordings alike."""
    fitted = rival.fitted - base.fitted - PER_NUMBER * (rival.freedom - base.freedom)
    held = rival.held_out - base.held_out
    if base.model.effects:  # the first one's imperfection must not be patched with a second
        share = SHARE * len(base.fit.white)
        if fitted < share or (len(base.held_white) and held < SHARE * len(base.held_white)):
            return False
    return rival.score - base.score > threshold and fitted > LEAST and held > -LEAST / 2


def settle(quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]) -> Judged:
    """Backward elimination and substitution: every effect must earn its place beside the others, and
    against its siblings in that company."""
    current = judged
    for name in judged.model.names:
        if name not in current.model.names:
            continue
        index = current.model.names.index(name)
        without = judge(quiet, held, current.model.without(index), 6, current.fit)
        say(f"  without {name}: {without.score - current.score:+.1f}")
        if without.score > current.score - KEEP and len(current.model.effects) > 1:
            current = without
            continue
        taken = _excluded(without.model)
        siblings = [s for s in EFFECTS[name].siblings if s not in taken]
        screened = Screen(quiet, without.fit).candidates([name, *siblings])
        for c in shortlist([c for c in screened if c.spec.name != name], 2)[:2]:
            start = with_best_start(quiet, without.model, c.spec)
            other = judge(quiet, held, start, 8, without.fit)
            say(f"  {c.spec.name} for {name}: {other.score - current.score:+.1f}")
            if other.score > current.score + SUBSTITUTE:
                current = other
                break
    return current
