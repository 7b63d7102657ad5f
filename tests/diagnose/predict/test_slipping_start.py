"""Where a recording begins, no form of a friction foretells more than another."""

from dataclasses import replace

import numpy as np
import pytest

from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.slipping import Slip
from ffl.diagnose.recorded.trials import prepare
from ffl.systems import EffectSpec
from ffl.systems.plant import Imperfections

NOISE = Noise(1e-7, 0.5)
RIGID = EffectSpec("coulomb_friction", {"level": 1.5})


@pytest.mark.parametrize("at_rest", [True, False])
@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e6])
def test_a_contact_that_holds_the_machine_is_no_better_told_where_it_begins(
    stage, record, at_rest, stiffness
):
    noisy = replace(stage, machine=Imperfections(NOISE.sensor, 1e-7, NOISE.force, None))
    run = record(replace(noisy, effects=(RIGID,)), 0)[0]
    model = Model(Base.of(noisy, float(np.ptp(run.y))))
    trial = replace(prepare(model.base.simulator, run, NOISE.sensor), at_rest=at_rest)
    values = {"level": 1.5, "stiffness": stiffness, "micro_damping": 0.0}
    forms = (), (RIGID,), (EffectSpec("presliding_friction", values),)
    first = [Slip(replace(model, effects=form), NOISE).predict([trial])[1][0] for form in forms]
    assert first[0] == pytest.approx(first[1], abs=1e-6)
    assert first[2] == pytest.approx(first[1], abs=1e-6)
