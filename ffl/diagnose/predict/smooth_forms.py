"""The form of a damper, or of a spring, beside a play.

The balance of forces starts a search with a damper, and a screen finds a spring that ends where a plain one
would do: either leads to its sibling, whose numbers follow from its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.diagnose.hypothesis.places import POINT
from ffl.diagnose.predict.dry_forms import LEAST
from ffl.diagnose.predict.foretold import Told, refitted
from ffl.diagnose.predict.joining import Company, Settled, charged, in_place, lost_to
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.plant import EffectSpec

DAMPER, DRAG = "viscous_friction", "quadratic_drag"
SPRING, TIGHTENED = "linear_stiffness", "preloaded_spring"


def smoothly(company: Company[Told], settled: Settled[Told]) -> Company[Told]:
    """`company` with the siblings of its damper, drag or tightened spring that foretell better, or as well
    with fewer numbers; the other is told as a rival. (Drag of 97 N s^2/m^2 beside a play, which a damper of
    35 N s/m had started: 1.7 times the noise was left. A spring of 90 N/m tightened by 4.5 N over 50 mm, of
    which no recording left more than 51.)"""
    for own in company.found.model.effects[:-1]:
        other = _sibling(own, company.trials)
        names = company.found.model.names
        if other is None or other.name in names:
            continue
        found, trials = company.found, company.trials
        tried = settled(refitted(in_place(found, own.name, other), trials), trials)
        fewer = len(tried.model.coordinates) < len(found.model.coordinates)
        ahead = charged(tried, trials) - charged(found, trials)
        least = -LEAST if fewer else lost_to(found, tried, company.judging)
        rivals = {name: told for name, told in company.rivals.items() if name != own.name}
        if ahead > least:
            company = Company(tried, trials, {**rivals, other.name: found}, judging=company.judging)
        else:
            company = Company(found, trials, {**rivals, own.name: tried}, judging=company.judging)
    return company


def _sibling(own: EffectSpec, trials: Sequence[Trial]) -> EffectSpec | None:
    """As strong at the RMS speed; as stiff where it is not at its end."""
    values, at = own.parameters, {k: v for k, v in own.options.items() if k in POINT}
    speed = np.concatenate([np.gradient(trial.y, trial.sample_time) for trial in trials])
    usual = float(np.sqrt(np.mean(speed**2)))
    if own.name == DAMPER and usual > 0.0:
        return EffectSpec(DRAG, {"coefficient": float(values["coefficient"]) / usual}, at)
    if own.name == DRAG:
        return EffectSpec(DAMPER, {"coefficient": float(values["coefficient"]) * usual}, at)
    if own.name == TIGHTENED:
        rate = float(values["preload"]) / float(values["width"])
        return EffectSpec(SPRING, {"stiffness": rate, "centre": float(values["centre"])}, at)
    return None
