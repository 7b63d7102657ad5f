"""The form of a contact that gives way, and the valley of its stiffness."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import pytest

from ffl.diagnose.hypothesis import contact
from ffl.systems.plant import EffectSpec

WORTH = {1.0: 0.0, 0.1: 230.0, 0.3: -0.2}  # of a bristle, by its stiffness


@dataclass(frozen=True)
class Fake:
    """A model, and judged what it is worth."""

    effects: tuple[EffectSpec, ...]
    theta: tuple[float, ...] = ()
    worth: dict[float, float] | None = None
    fit: None = None

    @property
    def names(self):
        return tuple(spec.name for spec in self.effects)

    def at(self, theta):
        return self

    @property
    def model(self):
        return self

    @property
    def score(self):
        own = self.effects[0]
        if own.options.get("kind") == "maxwell_slip":
            return -100.0
        return self.worth[round(own.parameters["stiffness"], 3)]


@pytest.mark.parametrize(("worth", "stiffness"), [(230.0, 0.1), (-5.0, 1.0)])
def test_a_softer_contact_stands_where_it_says_more(monkeypatch, worth, stiffness):
    """Between two valleys every stiffness is worse: 0.3 is no way to 0.1."""
    values = {"level": 2.0, "stiffness": 1.0, "micro_damping": 0.0}
    begun = Fake(
        (EffectSpec("presliding_friction", values),), worth={**WORTH, 0.1: worth, 0.03: -9.0}
    )
    monkeypatch.setattr(contact, "judge", lambda quiet, held, start, *_: start)
    monkeypatch.setattr(contact, "levelled", list)
    quiet = SimpleNamespace(cost=lambda start: 1.0)
    found = contact.with_other_contact(quiet, None, begun, lambda line: None)
    assert found.effects[0].parameters["stiffness"] == pytest.approx(stiffness)
    assert replace(found, effects=begun.effects) == begun
