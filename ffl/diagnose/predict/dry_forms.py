"""Which form of dry friction stands beside a play: each in its place, foretold from sample to sample."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ffl.diagnose.contest.dry import DRY, level_of, plain_form
from ffl.diagnose.hypothesis.places import placed
from ffl.diagnose.predict.company import along
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.joining import (
    ROUGH,
    Company,
    Settled,
    Told,
    charged,
    in_place,
    lost_to,
)
from ffl.diagnose.predict.moving import SURE, doubted, moved
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.systems.plant import EffectSpec

KNOTS = 9  # of a table
NEAR = 250.0  # log-likelihood that a form may be behind, its numbers fitted once, and yet come out ahead
STRIBECK = (0.02, 0.1)  # of the RMS speed
RISES = 1.5  # of the level at speed: what the level at rest begins at
# Of the travel, over which a contact yields: between two of them in four nothing showed that it does.
YIELDS = np.geomspace(2e-4, 3e-2, 16)
# Log-likelihood by which a form of more numbers must be ahead, where moments of contact make it rough.
LEAST = 100.0


def formed(company: Company[Told], settled: Settled[Told]) -> Company[Told]:
    """`company` with the form of its dry friction that foretells best, the plainest where another is not
    clearly ahead; the best of the others is told as its rival."""
    found, trials = company.found, company.trials
    own = next((s for s in found.model.effects if s.name in DRY), None)
    if own is None or (level := level_of(own)) is None:
        return company
    at = found.model.effects.index(own)
    tried = [found]
    for starts in _forms(own, level, trials):
        begun = [in_place(found, own.name, spec) for spec in starts]
        other = refitted(max(begun, key=lambda form: form.worth(trials)), trials)
        if along(starts[0]):  # its likelihood is narrow along the stiffness
            other = moved(other, trials)
        if charged(other, trials) > charged(found, trials) - NEAR:
            tried.append(settled(other, trials))
    tried.sort(key=lambda form: len(form.model.coordinates))
    best = tried[0]
    for form in tried[1:]:
        least = LEAST + lost_to(best, form, company.judging)
        best = form if charged(form, trials) > charged(best, trials) + least else best
    plain = plain_form(best.model.effects[at])
    if plain is not None:  # another form may have come further with all other numbers
        begun_there = in_place(best, best.model.names[at], plain)
        tried.append(settled(refitted(begun_there, trials), trials))
        least = LEAST + lost_to(tried[-1], best, company.judging)
        best = tried[-1] if charged(tried[-1], trials) > charged(best, trials) - least else best
    rest = [form for form in tried if form.model.names != best.model.names]
    rivals = {name: told for name, told in company.rivals.items() if name != own.name}
    if rest:
        rivals[best.model.names[at]] = max(rest, key=lambda form: charged(form, trials))
    return Company(best, trials, rivals)


def plainly(
    company: Company[Told], found: Told, trials: Sequence[Trial]
) -> tuple[Company[Told], Told]:
    """(`company`, `found`) with the plainest friction, where its form is not clearly ahead on all `trials`:
    it was told on fewer. (Plain friction of 2 N beside a play was Stribeck's, 2.0200 N and 2.0204.)"""
    own = next((s for s in found.model.effects if s.name in DRY), None)
    plain = None if own is None else plain_form(own)
    if own is None or plain is None:
        return company, found
    tried = refitted(in_place(found, own.name, plain), trials)
    if charged(tried, trials) < charged(found, trials) - LEAST:
        if not _alike(own, found, trials):
            return company, found
        tried = moved(tried, trials)
    rivals = {name: told for name, told in company.rivals.items() if name != own.name}
    return Company(tried, company.trials, {**rivals, plain.name: company.found}), tried


def _alike(own: EffectSpec, found: Told, trials: Sequence[Trial]) -> bool:
    """Whether the levels of either direction differ by no more than `SURE` standard errors: then what a
    rough likelihood has the two ahead of one says nothing."""
    fit = found.fit(trials) if own.name == "asymmetric_friction" else None
    if fit is None:
        return False
    cov = doubted(fit, found, trials, ROUGH).covariance
    at = found.model.names.index(own.name)
    coordinates = found.model.coordinates
    two = [k for k, c in enumerate(coordinates) if c.effect == at and c.name.startswith("level")]
    if len(two) != 2:
        return False
    way = np.array([1.0, -1.0])
    apart = abs(float(way @ found.theta[two]))
    return apart < SURE * float(np.sqrt(way @ cov[np.ix_(two, two)] @ way))


def _forms(own: EffectSpec, level: float, trials: Sequence[Trial]) -> list[list[EffectSpec]]:
    """Other forms of the same friction, each from where it may begin."""
    y = np.concatenate([trial.y for trial in trials])
    v = np.concatenate([np.gradient(trial.y, trial.sample_time) for trial in trials])
    speed, span = float(np.sqrt(np.mean(v**2))), float(np.ptp(y))
    ways = {"positive": level, "negative": level}
    if own.name == "asymmetric_friction":
        ways = {way: float(own.parameters[f"level_{way}"]) for way in ways}
    grid = [float(x) for x in np.linspace(y.min(), y.max(), KNOTS)]
    table = {"grid": grid, **{way: [value] * KNOTS for way, value in ways.items()}}
    starts: dict[str, list[dict[str, Any]]] = {
        "coulomb_friction": [{"level": level}],
        "asymmetric_friction": [{f"level_{way}": value for way, value in ways.items()}],
        "stribeck_friction": [
            {
                "coulomb_level": level,
                "static_level": RISES * level,
                "stribeck_velocity": share * speed,
            }
            for share in STRIBECK
        ],
        "presliding_friction": [
            {"level": level, "stiffness": level / (share * span), "micro_damping": 0.0}
            for share in YIELDS.tolist()
        ],
        "position_dependent_friction": [{"table": table, "level": level}],
    }
    kept = placed(own)
    return [
        [EffectSpec(name, one, {**kept, **_kind(name)}) for one in values]
        for name, values in starts.items()
        if name != own.name
    ]


def _kind(name: str) -> dict[str, Any]:
    """Options of the form of machines."""
    return EFFECTS[name].forms(True)[0]
