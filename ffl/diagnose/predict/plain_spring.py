"""A spring beside a play that a screen finds tightened where a plain one would do."""

from __future__ import annotations

from ffl.diagnose.hypothesis.places import placed
from ffl.diagnose.predict.dry_forms import LEAST
from ffl.diagnose.predict.foretold import Told, refitted
from ffl.diagnose.predict.joining import Company, Settled, charged, in_place
from ffl.systems.plant import EffectSpec

PLAIN, TIGHTENED = "linear_stiffness", "preloaded_spring"


def untightened(company: Company[Told], settled: Settled[Told]) -> Company[Told]:
    """`company` with a plain spring for a tightened one, as stiff where that is not at its end, where it
    foretells no clearly worse; the other is told as its rival. (A spring of 90 N/m was one tightened by
    4.5 N over 50 mm, of which no recording left more than 51.)"""
    found, trials = company.found, company.trials
    own = next((spec for spec in found.model.effects[:-1] if spec.name == TIGHTENED), None)
    if own is None or PLAIN in found.model.names:
        return company
    rate = float(own.parameters["preload"]) / float(own.parameters["width"])
    values = {"stiffness": rate, "centre": float(own.parameters["centre"])}
    plain = EffectSpec(PLAIN, values, placed(own))
    tried = settled(refitted(in_place(found, TIGHTENED, plain), trials), trials)
    rivals = {name: told for name, told in company.rivals.items() if name != TIGHTENED}
    if charged(tried, trials) > charged(found, trials) - LEAST:
        return Company(tried, trials, {**rivals, PLAIN: found}, company.judging)
    return Company(found, trials, {**rivals, TIGHTENED: tried}, company.judging)
