"""An effect as it is told: its numbers with their errors, how sure it is, and what else it may be."""

from __future__ import annotations

import numpy as np
import scipy.stats

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.posterior import probabilities
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.hypothesis.amounts import of_its_own
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.spread import error_of, errors_through
from ffl.diagnose.number import Number
from ffl.diagnose.result import Finding
from ffl.effects import EFFECTS
from ffl.effects.linear_mechanics import as_seen
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array


def finding(
    standing: Judged, index: int, outcome: Outcome, plant: Plant, elsewhere: float
) -> Finding:
    """Effect `index` of what stands, in the units of `plant`, by the numbers that are seen from outside;
    `elsewhere`: the probability that it is nobody who was tried."""
    fitted = standing.model.effects[index]
    spec = _as_seen(standing.model, fitted)
    effect = EFFECTS[spec.name]
    errors = {name: error_of(standing, index, name) for name in spec.parameters}
    errors |= _errors_as_seen(standing, index, spec) if spec is not fitted else {}
    numbers = {}
    for name, value in spec.parameters.items():
        parameter = effect.parameter(name)
        error = None if parameter.stepped else errors[name]
        numbers[name] = Number(value, parameter.unit_in(plant), error)
    says, share = (
        effect.says({**spec.options, **effect.check(spec)}, plant),
        of_its_own(standing.model, spec),
    )
    if share is not None:
        says += f" That is {100.0 * share:+.3g} % of the model's own."
    shares = probabilities(spec.name, outcome.contenders, elsewhere)
    own = shares.pop(spec.name)
    others = sorted(shares.items(), key=lambda item: -item[1])
    return Finding(
        spec.name,
        effect.component,
        numbers,
        spec.options,
        own,
        _p_value(spec.name, outcome.steps),
        says,
        tuple((name, p) for name, p in others if p > 1e-3)[:4],
    )


def _as_seen(model: Model, spec: EffectSpec) -> EffectSpec:
    """`spec`, one of the effects of `model`, as augmented.toml tells it."""
    at = next(k for k, own in enumerate(model.acting) if own is spec)
    return as_seen(model.plant(), len(model.effects)).effects[at]


def _errors_as_seen(standing: Judged, index: int, told: EffectSpec) -> dict[str, float | None]:
    """Standard errors of the numbers of `told` that were not fitted as they are told."""
    fitted = standing.model.effects[index].parameters
    names = [n for n, value in told.parameters.items() if value != fitted[n]]

    def numbers(model: Model) -> Array | None:
        other = _as_seen(model, model.effects[index])
        alike = other.options == told.options
        return np.array([other.parameters[n] for n in names]) if alike else None

    errors = errors_through(standing, numbers)
    return {n: float(e) if np.isfinite(e) else None for n, e in zip(names, errors, strict=True)}


def _round_of(name: str, steps: list[Step]) -> Step | None:
    for step in steps:
        if name in step.joined:
            return step
    return None


def _p_value(name: str, steps: list[Step]) -> float | None:
    """Likelihood ratio of the fitted recordings, for the free numbers it added."""
    step = _round_of(name, steps)
    if step is None or step.accepted is None:
        return None
    ratio = 2.0 * (step.accepted.fitted - step.before.fitted)
    freedom = max(1, step.accepted.freedom - step.before.freedom)
    return float(max(scipy.stats.chi2.sf(max(ratio, 0.0), freedom), 1e-300))
