"""The kernel compiles once, whatever runs in it; and it reproduces a real machine."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from ffl.effects import EFFECTS
from ffl.errors import WorkError
from ffl.machines import SimulatedMachine, Simulator, kernel
from ffl.systems.loop import Controller
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.plant_file import load_plant
from ffl.systems.references import Move, moves
from ffl.systems.zpk import Zpk

FRICTION = EffectSpec("coulomb_friction", {"level": 2.0})
COGGING = EffectSpec("cogging", {"amplitude": 1.0, "period": 0.01})
DELAY = EffectSpec("input_delay", {"delay": 1.5e-3})
RIPPLE = EffectSpec("encoder_ripple", {"amplitude": 1e-6, "period": 0.01})
REFERENCE = moves([Move(0.05, 0.05, 0.3, 5.0, 200.0)], 0.5, 1e-3)


def test_a_new_combination_does_not_recompile_the_kernel():
    for name in ("emps", "flatbed_printer"):
        simulator = Simulator(load_plant(name))
        for effects in ((), (FRICTION,), (COGGING, FRICTION, DELAY), (RIPPLE, DELAY) * 5):
            simulator.run(effects, REFERENCE)
    assert len(kernel.run_loop.signatures) == 1


@pytest.mark.slow(5)
def test_a_second_process_reads_the_compiled_kernel():
    code = (
        "from ffl.machines import Simulator, kernel; from ffl.systems.plant import EffectSpec; "
        "from ffl.systems.plant_file import load_plant; "
        "Simulator(load_plant('emps')).run([EffectSpec('coulomb_friction', {'level': 2.0})], [0.0]); "
        "print(sum(kernel.run_loop.stats.cache_misses.values()))"
    )
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True
        )
    assert done.stdout.strip() == "0"


def test_runs_do_not_depend_on_their_order():
    simulator = Simulator(load_plant("emps"))
    sets = [(), (FRICTION,), (COGGING, FRICTION), (DELAY,)]
    forth = [simulator.run(effects, REFERENCE).y for effects in sets]
    back = [simulator.run(effects, REFERENCE).y for effects in reversed(sets)][::-1]
    for one, other in zip(forth, back, strict=True):
        assert np.array_equal(one, other)


def test_a_zero_effect_changes_nothing():
    simulator = Simulator(load_plant("emps"))
    linear = simulator.run((), REFERENCE).y
    nothing = [
        EffectSpec("coulomb_friction", {"level": 0.0}),
        EffectSpec("viscous_friction", {"coefficient": 0.0}),
        EffectSpec("cogging", {"amplitude": 0.0, "period": 0.01}),
        EffectSpec("input_delay", {"delay": 0.0}),
        EffectSpec("actuator_lag", {"time_constant": 0.0}),
        EffectSpec("dead_zone", {"half_width": 0.0}),
        EffectSpec("saturation", {"limit": 1e9}),
        EffectSpec("backlash", {"gap": 0.0}),
        EffectSpec("mass_change", {"change": 0.0}),
    ]
    for spec in nothing:
        y = simulator.run([spec], REFERENCE).y
        assert np.abs(y - linear).max() < 1e-11 * np.abs(linear).max(), spec.name


def test_a_delay_acts_first_wherever_it_is_named():
    """What is late is late alike before a lag and behind it; its law is exact where a command stands still
    over a step."""
    lag = EffectSpec("actuator_lag", {"time_constant": 1.5e-3})
    simulator = Simulator(load_plant("emps"))
    one, other = (simulator.run(e, REFERENCE) for e in ((lag, DELAY), (DELAY, lag)))
    assert np.array_equal(one.y, other.y)
    assert np.array_equal(one.contribution, other.contribution[:, ::-1])


@pytest.mark.parametrize(
    "bent",
    [EffectSpec("saturation", {"limit": 20.0}), EffectSpec("dead_zone", {"half_width": 9.0})],
)
def test_what_bends_the_command_bends_it_before_a_delay(bent):
    """A limit behind a delay of 1.5 samples would meet the mean of two commands: what is late is as the
    drive gave it, wherever both are named, from the first sample on."""
    simulator = Simulator(load_plant("emps"), open_loop=True)
    u = 30.0 * np.sin(np.linspace(1.0, 40.0, 400))
    alone = simulator.run((bent,), feedforward=u, before=u[0])
    sent = u + alone.contribution[:, 0]
    late = simulator.run((DELAY,), feedforward=sent, before=sent[0])
    for effects in ((bent, DELAY), (DELAY, bent)):
        both = simulator.run(effects, feedforward=u, before=u[0])
        np.testing.assert_allclose(both.y, late.y, atol=1e-12 * np.abs(late.y).max())


def test_a_machine_that_diverges_says_when():
    """Twenty samples of extra delay make the stable loop oscillate without bound."""
    system = Zpk([-1.0], [1.0, 1.0], 2.5e-7, 1e-3)
    lead = Controller.of_error(Zpk([0.98], [0.8], 4e5, 1e-3))
    late = EffectSpec("input_delay", {"delay": 0.02})
    plant = Plant("late", system, lead, "N", "m", effects=(late,))
    machine = SimulatedMachine(plant)
    reference = np.concatenate([REFERENCE, np.full(6000, REFERENCE[-1])])
    with pytest.raises(WorkError, match=r"late diverged at t = [0-9.]+ s"):
        machine.run(reference, None, np.random.default_rng(0))


def test_effects_of_the_plant_file_run_in_the_machine():
    plant = load_plant("emps")
    rough = Plant("rough", plant.system, plant.controller, "N", "m", effects=(FRICTION,))
    trial = SimulatedMachine(rough).run(REFERENCE, None, np.random.default_rng(0))
    same = Simulator(plant).run((FRICTION,), REFERENCE)
    assert np.array_equal(trial.y, same.y)


def test_emps_with_its_documented_friction():
    """The servo error of the real carriage, from 27.5 um RMS with the mass alone to 1.65 with the
    documented friction and offset (data README; measured here 1.64)."""
    folder = Path(os.environ.get("FFL_DATA", "../shared/data"))
    file = folder / "emps" / "DATA_EMPS.mat"
    if not file.exists():
        pytest.skip(f"{file} is missing; get EMPS from nonlinearbenchmark.org into FFL_DATA")
    data = scipy.io.loadmat(file)
    reference, y = data["qg"].ravel(), data["qm"].ravel()
    simulator = Simulator(load_plant("emps"))
    documented = [
        EffectSpec("viscous_friction", {"coefficient": 203.5}),
        EffectSpec("coulomb_friction", {"level": 20.39}),
        EffectSpec("constant_load", {"force": 3.165}),
    ]
    start = simulator.at_rest(y[0])
    bare = simulator.run((), reference, start=start).y - y
    full = simulator.run(documented, reference, start=start).y - y
    assert 26e-6 < np.sqrt(np.mean(bare[20:] ** 2)) < 29e-6
    assert np.sqrt(np.mean(full[20:] ** 2)) < 1.7e-6


def test_a_changed_helper_drops_the_compiled_laws(tmp_path, monkeypatch):
    """Numba's cache does not see that a law's helpers have changed; `address_of` does."""
    from ffl.effects import law

    (tmp_path / "__pycache__").mkdir()
    source = tmp_path / "my_effect.py"
    source.write_text("def _law(p, s, io):\n    io[10] = p[0]\n")
    scope: dict = {}
    exec(compile(source.read_text(), str(source), "exec"), scope)
    stale = tmp_path / "__pycache__" / "my_effect._law-1.py311.nbi"
    fresh = tmp_path / "__pycache__" / "my_effect._law-2.py311.nbi"
    for file, age in ((stale, 0), (fresh, 4e9)):
        file.write_bytes(b"")
        os.utime(file, (age, age))
    law._drop_stale(scope["_law"])
    assert not stale.exists()
    assert fresh.exists()


def test_helpers_are_all_files_that_a_law_is_made_of():
    """What they are is read from the law: a new helper needs no entry in a list."""
    from ffl.effects import law

    def helpers(name):
        return {path.name for path in law.helpers_of(EFFECTS[name].law)}

    assert helpers("saturation") == {"law.py"}
    assert helpers("coulomb_friction") == {"law.py", "solve.py"}
    assert helpers("cogging") == {"law.py", "solve.py", "periods.py"}
    assert helpers("presliding_friction") >= {"law.py", "solve.py", "bristle.py"}
