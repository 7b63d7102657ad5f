"""Who joins a play, on which clocks, and in which form."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from test_play_and_company import PLAY, told

from ffl.diagnose.predict import joining, smooth_forms
from ffl.diagnose.predict.joining import Company
from ffl.diagnose.predict.play import able
from ffl.diagnose.predict.smooth_forms import _sibling
from ffl.systems.plant import EffectSpec


@pytest.mark.parametrize(("settling", "joins"), [(400.0, True), (40.0, False)])
def test_who_may_join_is_asked_again_where_settling_alone_brought_much(
    monkeypatch, settling, joins
):
    """Beside half of its gap a play leaves a sine nothing to bring; settled, it does."""
    half, whole = told(("backlash",), 0.0, 0.0), told(("backlash",), settling, 0.0)
    early = told(("periodic_disturbance", "backlash"), 50.0, 0.0)
    late = told(("periodic_disturbance", "backlash"), 900.0, 0.0)

    def ranked(company, *_):  # type: ignore[no-untyped-def]
        who = {id(half): early, id(whole): late}.get(id(company.found))
        return [joining._Way(who, ("fitted",), 100.0)] if who else []

    monkeypatch.setattr(joining, "_ranked", ranked)
    company = joining.joined(
        Company(half, ("fitted",)),
        None,
        able,
        lambda point, trials: whole if point is half else point,
    )
    assert company.found is (late if joins else whole)


def clocked_by(right):  # type: ignore[no-untyped-def]
    """Told of a settling of 0.8 s and a sine of 2 Hz, and what it foretells of a clock."""
    effects = (
        EffectSpec("periodic_disturbance", {"frequency": 2.0, "amplitude": 1.0, "phase": 0.0}),
        EffectSpec("drift", {"amplitude": 1.0, "time_constant": 0.8}),
    )
    model = SimpleNamespace(effects=effects)

    def scaled(trials):  # type: ignore[no-untyped-def]
        warm, turn = np.exp(-trials[0].start_time / 0.8), 4 * np.pi * trials[0].start_time
        away = 10.0 * abs(warm - np.exp(-right / 0.8)) + abs(
            np.exp(1j * (turn - 4 * np.pi * right)) - 1
        )
        return -away, 1.0

    return SimpleNamespace(model=model, scaled=scaled)


@dataclass(frozen=True)
class Begun:
    start_time: float


@pytest.mark.parametrize("right", [0.0, 0.37, 0.83, 3.9])
def test_clocks_are_moved_to_where_it_has_settled_and_in_step(right):
    first, second = joining.in_step(clocked_by(right), [Begun(0.0), Begun(0.0)], 1)
    assert first.start_time == 0.0  # as it is: before `from_trial`
    assert abs(np.exp(-second.start_time / 0.8) - np.exp(-right / 0.8)) < 0.3
    turns = 2.0 * (second.start_time - right)
    assert abs(turns - round(turns)) < 0.05
    alone = clocked_by(right)
    alone.model.effects = alone.model.effects[1:]
    (only,) = joining.in_step(alone, [Begun(0.2)], 0)
    assert only.start_time >= 0.0  # nothing had begun to settle before it did


def test_a_damper_has_a_drag_for_a_sibling_and_a_tightened_spring_a_plain_one():
    """As strong at the RMS speed; as stiff where it is not at its end."""
    t = np.arange(2000) * 1e-3
    trials = [SimpleNamespace(y=0.01 * np.sin(2 * np.pi * t), sample_time=1e-3)]
    usual = 0.01 * 2 * np.pi / np.sqrt(2.0)
    damper = EffectSpec("viscous_friction", {"coefficient": 30.0}, {"side": "motor"})
    drag = _sibling(damper, trials)
    assert drag.name == "quadratic_drag"
    assert drag.options == {"side": "motor"}
    assert drag.parameters["coefficient"] * usual == pytest.approx(30.0, rel=0.01)
    assert _sibling(drag, trials).parameters["coefficient"] == pytest.approx(30.0)
    tight = EffectSpec("preloaded_spring", {"preload": 4.5, "width": 0.05, "centre": -0.02})
    assert _sibling(tight, trials) == EffectSpec(
        "linear_stiffness", {"stiffness": 90.0, "centre": -0.02}
    )
    assert _sibling(PLAY, trials) is None


@pytest.mark.parametrize(
    ("other", "numbers", "taken"),
    [(50.0, 2, True), (-50.0, 2, False), (-50.0, 1, True), (-150.0, 1, False)],
)
def test_a_sibling_is_taken_that_foretells_better_or_as_well_with_less(
    monkeypatch, other, numbers, taken
):
    own = told(("viscous_friction", "backlash"), 0.0, 0.0)
    own.model.coordinates = (0, 0)
    tried = told(("quadratic_drag", "backlash"), other, 0.0)
    tried.model.coordinates = (0,) * numbers
    drag = EffectSpec("quadratic_drag", {"coefficient": 1.0})
    siblings = {"viscous_friction": drag}
    monkeypatch.setattr(smooth_forms, "_sibling", lambda spec, trials: siblings.get(spec.name))
    monkeypatch.setattr(smooth_forms, "in_place", lambda *_: tried)
    monkeypatch.setattr(smooth_forms, "refitted", lambda found, trials: found)
    monkeypatch.setattr(smooth_forms, "charged", lambda found, trials: found.worth(trials))
    company = smooth_forms.smoothly(Company(own, ("fitted",)), lambda found, trials: found)
    assert (company.found is tried) is taken
    (rival,) = company.rivals.items()
    assert rival == (("quadratic_drag", own) if taken else ("viscous_friction", tried))
