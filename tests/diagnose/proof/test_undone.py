"""A formula and a correction beside it that undo one another are said to."""

from types import SimpleNamespace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.amounts import effect_values
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.maps.formula import Formula, _by_speed
from ffl.diagnose.maps.shapes import STRAIGHT, library, one
from ffl.diagnose.proof.conclude import _undone


def drawn(along: str, driver: str, port: str = "force"):  # type: ignore[no-untyped-def]
    term = SimpleNamespace(along=along, driver=driver)
    return SimpleNamespace(term=term, place=SimpleNamespace(port=port))


def test_the_part_by_speed_alone_is_known():
    shapes = list(library(-1.0, 1.0, True))
    wave, bump = (next(s for s in shapes if s.text.startswith(t)) for t in ("sin", "exp"))
    level = next(s for s in shapes if s.columns is one)
    weights = np.array([1.0, 2.0, -30.0, 10.9])
    assert _by_speed(drawn("position", "velocity"), [wave, bump, level], weights) == 10.9
    assert _by_speed(drawn("position", ""), [wave, bump, level], weights) == 0.0
    assert _by_speed(drawn("velocity", ""), [wave, bump, STRAIGHT], weights) == 10.9
    assert _by_speed(drawn("velocity", "", "output"), [STRAIGHT], weights[3:]) == 0.0
    assert _by_speed(drawn("velocity", "velocity"), [level], weights[3:]) == 0.0


@pytest.mark.parametrize(("share", "says"), [(0.9, True), (1.0, True), (0.5, False), (-1.0, False)])
def test_what_a_damping_takes_back_is_said(stage, share, says):  # type: ignore[no-untyped-def]
    bare = Model(Base.of(stage), corrections={"damping": 2.0})
    pushes = effect_values(bare, "damping")["coefficient"] / share
    formula = Formula("force = ...", None, None, 1.0, pushes)
    contest = SimpleNamespace(formulas=(formula,))
    said = _undone(SimpleNamespace(bare=bare, contest=contest))  # type: ignore[arg-type]
    assert (said is not None) is says
    if said:
        assert f"{pushes:.4g} velocity" in said
    alone = SimpleNamespace(bare=Model(Base.of(stage)), contest=contest)
    assert _undone(alone) is None  # type: ignore[arg-type]
