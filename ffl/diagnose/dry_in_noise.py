"""Dry friction where noise decides when a machine lets go, told by prediction.

The contest judges by simulations without noise. Near standstill noise moves a machine that a simulation
holds, and smooths the friction: free runs then ask for a fraction of its level, or for a damping in its
place, and for the form that bends best. (A level of 0.68 N in the mean came out as 0.38 N, under force
noise of 0.38 N.) Here every form is fitted to what a filter that sticks and slips (`slipping`) leaves
from sample to sample, corrections of the linear model beside it. Without friction the filter's
likelihood is that of whitening; the friction must be the likelier by either measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.company import separable
from ffl.diagnose.foretold import refitted
from ffl.diagnose.judging import Judged
from ffl.diagnose.line import crosses
from ffl.diagnose.model import Model
from ffl.diagnose.noise import Noise, partly_coloured
from ffl.diagnose.places import POINT, places_of
from ffl.diagnose.rounds import Outcome, Step
from ffl.diagnose.scene import Scene
from ffl.diagnose.settle import DRY
from ffl.diagnose.slipping import LINEAR, Slip
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PASSES = frozenset({"viscous_friction", "quadratic_drag"})  # for dry friction in noise
CLEAR = 15.0  # log-likelihood, fitted and held out alike, over no friction and over free runs
TRUSTED = 1.5  # times the stated noise: a filter that needs more leaves more than noise
LEVELS = np.geomspace(0.01, 1.0, 8)  # of the RMS force
FALLS = (0.03, 0.1, 0.3)  # of the RMS speed
YIELDS = (5e-4, 2e-3, 1e-2, 5e-2)  # of the travel
KNOTS = 9  # of a table


def with_dry_friction(
    scene: Scene, held: Scene | None, outcome: Outcome, told: Model, prior: Noise
) -> Outcome:
    """`outcome`, or, where a dry friction foretells fitted and held-out recordings clearly better than what
    stands in its place, that friction; `told`: the model with no effect, `prior`: noise as the plant file
    states it."""
    standing = outcome.standing
    if held is None or told.acting or standing.predicted:
        return outcome
    company = _company(standing.model)
    if company is None:
        return outcome
    told = replace(told, effects=company)
    if scene.plain or scene.observed or not told.base.plant.machine.states_noise:
        return outcome
    if not all(np.all(np.isfinite(trial.u)) for trial in (*scene.trials, *held.trials)):
        return outcome
    if not told.base.simulator.mechanics.modes:
        return outcome
    none, *forms = _forms(scene, told, (prior, partly_coloured(prior), standing.scene.noise))
    judged = [_judged(found, scene, held) for found in (none, *forms)]
    if any(one is None for one in judged):
        return outcome
    plain, *rivals = [one for one in judged if one is not None]
    best = max(rivals, key=lambda one: one.score)
    before = replace(standing, held_out=_by_free_runs(standing, held))
    gains = [
        b - a for one in (plain, before) for a, b in zip(_worth(one), _worth(best), strict=True)
    ]
    if min(gains) < CLEAR or crosses(scene, best) or _louder(best.scene.noise, prior) > TRUSTED:
        return outcome
    name = best.model.names[-1]
    step = Step(standing, (), (best,), best)
    kept = {k: v for k, v in outcome.contenders.items() if k in best.model.names}
    contenders = {**kept, name: [(one.model.names[-1], one) for one in rivals]}
    return Outcome(best, [*outcome.steps, step], outcome.held, contenders)


def _company(model: Model) -> tuple[EffectSpec, ...] | None:
    """What stands beside a friction or what passes for one; None where neither stands, or something that
    the filter does not know."""
    names = set(model.names)
    friction = names & DRY or names & PASSES
    if model.effects and len(friction) != 1:
        return None
    beside = tuple(spec for spec in model.effects if spec.name not in friction)
    return beside if all(spec.name in LINEAR or separable(spec) for spec in beside) else None


def _louder(noise: Noise, stated: Noise) -> float:
    """How many times louder force or sensor are than stated."""
    force = np.hypot(noise.force, noise.force_coloured) / np.hypot(
        stated.force, stated.force_coloured
    )
    sensor = np.hypot(noise.sensor, noise.sensor_coloured)
    return float(max(force, sensor / np.hypot(stated.sensor, stated.sensor_coloured)))


def _worth(judged: Judged) -> tuple[float, float]:
    """Of the fitted recordings, its numbers charged, and of the held-out ones."""
    return judged.score - judged.held_out, judged.held_out


def _by_free_runs(standing: Judged, held: Scene) -> float:
    """Log-likelihood of recordings by a free run under the noise that was found, its size left open."""
    judged = held.like(standing.scene)
    residuals = judged.residuals(standing.model)
    return -np.inf if residuals is None else judged.likeliest(judged.whiten(residuals))


def _rms(parts: Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def _forms(scene: Scene, told: Model, noises: Sequence[Noise]) -> list[Slip]:
    """No friction and its forms, where plain friction foretells best, under that of the `noises` that suits
    it."""
    trials = scene.trials
    force = _rms([t.u for t in trials]) * told.base.simulator.force_per_input
    tried = []
    for noise in noises:
        for place in places_of(told):
            begun = [
                _with(told, noise, "coulomb_friction", place.options, level=force * size)
                for size in LEVELS
            ]
            tried.append(refitted(max(begun, key=lambda h: h.worth(trials)), trials))
    plain = max(tried, key=lambda h: h.worth(trials))
    spec, noise = plain.model.effects[-1], plain.noise
    level, options = (
        spec.parameters["level"],
        {k: spec.options[k] for k in POINT if k in spec.options},
    )
    bare = plain.model.without(len(told.effects))
    speed = _rms([np.diff(t.y) / t.sample_time for t in trials])
    low, high = (end(end(t.y) for t in trials) for end in (min, max))
    flat = [level] * KNOTS
    table = {"grid": np.linspace(low, high, KNOTS).tolist(), "positive": flat, "negative": flat}
    starts: dict[str, list[dict[str, Any]]] = {
        "asymmetric_friction": [{"level_positive": level, "level_negative": level}],
        "stribeck_friction": [
            {
                "coulomb_level": 0.9 * level,
                "static_level": 1.5 * level,
                "stribeck_velocity": v * speed,
            }
            for v in FALLS
        ],
        "presliding_friction": [
            {"level": level, "stiffness": level / (x * told.base.travel), "micro_damping": 0.0}
            for x in YIELDS
        ],
        "position_dependent_friction": [{"level": level, "table": table}],
    }
    out = [refitted(Slip(told, noise), trials), plain]
    for name, values in starts.items():
        fits = [refitted(_with(bare, noise, name, options, **own), trials) for own in values]
        out.append(max(fits, key=lambda h: h.worth(trials)))
    return out


def _with(model: Model, noise: Noise, name: str, options, **values: Any) -> Slip:  # type: ignore[no-untyped-def]
    return Slip(model.with_effect(EffectSpec(name, values, dict(options))), noise)


def _judged(found: Slip, scene: Scene, held: Scene) -> Judged | None:
    fitted, factor = found.scaled(scene.trials)
    found = replace(found, noise=found.noise.scaled(factor))
    fit, ahead = found.fit(scene.trials), found.predict(held.trials)
    if fit is None or ahead is None:
        return None
    own = replace(scene, noise=found.noise)
    judged = found.scaled(held.trials)[0]
    return Judged(fit, own, fitted, judged, ahead[0], held, predicted=True)
