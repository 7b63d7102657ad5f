"""Who a screen proposes: an effect at a place with starting values, and what it promises there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ffl.diagnose.hypothesis.fit import Fit
from ffl.diagnose.hypothesis.places import Place
from ffl.effects import EFFECTS, Effect
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at a place with starting values; `gain` is what it takes off the residual's sum of
    squares to first order with `freedom` coefficients, beside `like`, at the grid value `nonlinear`;
    `valleys`: starts in other valleys of its cost, of less gain."""

    spec: EffectSpec
    gain: float
    freedom: int
    place: Place
    like: Fit
    nonlinear: Mapping[str, float] = field(default_factory=dict)
    valleys: tuple[EffectSpec, ...] = ()


def with_coefficients(c: Candidate, coefficients: Array) -> EffectSpec:
    """The candidate's effect with other coefficients of its columns."""
    return spec_of(EFFECTS[c.spec.name], c.place, coefficients, c.nonlinear)


def spec_of(
    effect: Effect, place: Place, coefficients: Array, nonlinear: Mapping[str, float]
) -> EffectSpec:
    """The effect at `place` with these coefficients of its columns."""
    own = coefficients[: _own_columns(effect, coefficients)]
    values = effect.from_coefficients(own, nonlinear)
    chosen = {key: values.pop(key) for key in list(values) if key in effect.options}
    return EffectSpec(effect.name, values, {**place.options, **chosen})


def _own_columns(effect: Effect, coefficients: Array) -> int:
    """Coefficients that belong to the first recording where every one has its own phase or beginning."""
    return {"periodic_disturbance": 2, "drift": 1}.get(effect.name, len(coefficients))
