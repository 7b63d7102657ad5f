"""An effect as it is told: its numbers with their errors, how sure it is, and what else it may be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.stats

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.posterior import probabilities
from ffl.diagnose.contest.rounds import Outcome, Step
from ffl.diagnose.hypothesis.amounts import of_its_own
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.spread import error_beside, error_of, errors_through, stepped_error_of
from ffl.diagnose.number import Number
from ffl.diagnose.result import Finding
from ffl.effects import EFFECTS
from ffl.effects.linear_mechanics import as_seen
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

DIRECT = "seen directly in the recordings"  # a level at which a sensor stands is no fitted number


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
        parameter, note = effect.parameter(name), ""
        error = stepped_error_of(standing, index, name) if parameter.stepped else errors[name]
        if error is None and spec.name in standing.model.proven:
            note = DIRECT
        numbers[name] = Number(value, parameter.unit_in(plant), error, note)
    says, share = (
        effect.says({**spec.options, **effect.check(spec)}, plant),
        of_its_own(standing.model, spec),
    )
    if (slope := _slope(standing, index, errors)) is not None:
        numbers, says = _as_ramp(numbers, *slope)
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


def _slope(
    standing: Judged, index: int, errors: Mapping[str, float | None]
) -> tuple[float, float] | None:
    """(slope, its standard error) of a drift of which no more is told: a ramp, or one that settles long
    after the recordings; None of any other. (Of a force that fell all through three recordings, amplitude
    and time constant of a ramp came as -7.6 +- 8.2e7 N and 14 +- 1.5e8 s.)"""
    spec = standing.model.effects[index]
    if spec.name != "drift" or spec.options.get("kind") == "sine":
        return None
    amplitude, lasts = (float(spec.parameters[n]) for n in ("amplitude", "time_constant"))
    error = errors["time_constant"]
    ends = max(trial.start_time + len(trial) * trial.sample_time for trial in standing.scene.trials)
    if spec.options.get("kind") == "ramp":
        ends = lasts
    elif (error is not None and error < lasts) or lasts < ends:
        return None
    slope = amplitude / lasts
    if spec.options.get("kind") != "ramp":
        slope *= -np.expm1(-ends / lasts) * lasts / ends
    own = error_beside(standing, index, "amplitude", "time_constant")
    return None if own is None else (slope, abs(slope) * own / max(abs(amplitude), 1e-300))


def _as_ramp(
    numbers: Mapping[str, Number], slope: float, error: float
) -> tuple[dict[str, Number], str]:
    """The numbers of a drift with an error of its amplitude alone, and the sentence about its slope."""
    amplitude, lasts = numbers["amplitude"], numbers["time_constant"]
    share = error / abs(slope)
    digits = int(np.clip(np.ceil(-np.log10(share)) + 2, 2, 8)) if share > 0.0 else 4
    says = (
        f"A slow force changes by {slope:.{digits}g} ± {error:.2g} {amplitude.unit}/s all through the "
        "recordings; where it would end they do not show."
    )
    own = replace(amplitude, std_error=abs(amplitude.value) * share)
    held = replace(lasts, std_error=None, note="by choice: only amplitude/time_constant is told")
    return {**numbers, "amplitude": own, "time_constant": held}, says


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
