"""What every effect of the catalogue must do, whoever wrote it."""

import numpy as np
import pytest
from cases import FLOW, PARAMETERS, STAGE, reference

from ffl.effects import EFFECTS, Motion, check_effects
from ffl.errors import InputError
from ffl.machines import SimulatedMachine, Simulator
from ffl.systems.plant import EffectSpec, Physics, Plant
from ffl.systems.plant_file import load_plant, plant_from_dict, save_plant

SIMULATOR = Simulator(STAGE)
NAMES = sorted(set(EFFECTS) - set(FLOW))

# Sizes small enough for the first order in the effect to be all of it (the loop is nonlinear in the
# rest), with the non-linear parameters of the regressor.
SMALL = {
    "coulomb_friction": ({"level": 1e-4}, {}),
    "asymmetric_friction": ({"level_positive": 1e-4, "level_negative": 2e-4}, {}),
    "viscous_friction": ({"coefficient": 1e-4}, {}),
    "stribeck_friction": (
        {"coulomb_level": 1e-4, "static_level": 2e-4, "stribeck_velocity": 0.05},
        {"stribeck_velocity": 0.05},
    ),
    "presliding_friction": (
        {"level": 1e-4, "stiffness": 0.1, "micro_damping": 0.0},
        {"displacement": 1e-3},
    ),
    "position_dependent_friction": (
        {"table": {"grid": [-0.02, 0.02], "positive": [1e-4, 2e-4], "negative": [2e-4, 1e-4]}},
        {"knots": 2.0, "low": -0.02, "high": 0.02},
    ),
    "logarithmic_friction": ({"level": 1e-4, "velocity": 0.02}, {"velocity": 0.02}),
    "constant_load": ({"force": 1e-4}, {}),
    "cogging": ({"amplitude": 1e-4, "period": 0.005, "phase": 0.3}, {"period": 0.005}),
    "linear_stiffness": ({"stiffness": 0.01, "centre": 0.002}, {}),
    "hardening_spring": ({"cubic_coefficient": 10.0, "centre": 0.001}, {"centre": 0.001}),
    "preloaded_spring": (
        {"preload": 1e-4, "centre": 0.001, "width": 0.002},
        {"centre": 0.001, "width": 0.002},
    ),
    "gravity_torque": ({"amplitude": 1e-4, "centre": 0.3}, {}),
    "position_dependent_gain": (
        {"linear_coefficient": 1e-4, "quadratic_coefficient": 1e-3, "centre": 0.01},
        {"centre": 0.01},
    ),
    "quadratic_drag": ({"coefficient": 1e-4}, {}),
    "backlash": ({"gap": 1e-8}, {"shape": 1e-8}),
    "hysteresis": (
        {"force": 1e-4, "displacement": 2e-3, "exponent": 1.0, "beta": 0.5},
        {"displacement": 2e-3, "exponent": 1.0, "beta": 0.5},
    ),
    "saturation": ({"limit": 7.0}, {"limit": 7.0}),
    "dead_zone": ({"half_width": 1e-4}, {"shape": 1e-4}),
    "slew_limit": ({"rate": 2000.0}, {"rate": 2000.0}),
    "valve_stiction": (
        {
            "band": 1e-3,
        },
        {"band": 1e-3, "kind": "jump"},
    ),
    "input_delay": ({"delay": 1e-6}, {"shape": 1e-6}),
    "actuator_lag": ({"time_constant": 1e-6}, {"shape": 1e-6}),
    "flexible_mode": (
        {"frequency": 40.0, "damping": 0.1, "mass_fraction": 1e-5},
        {"frequency": 40.0, "damping": 0.1},
    ),
    "mass_change": ({"change": 1e-5}, {}),
    "encoder_ripple": ({"amplitude": 1e-9, "period": 0.004, "phase": 1.0}, {"period": 0.004}),
    "sensor_lead": ({"lead": 1e-7}, {}),
    "sensor_nonlinearity": (
        {"kind": "clipping", "level": 0.0271},
        {"kind": "clipping", "level": 0.0271},
    ),
    "sensor_bend": ({"level": 0.012, "ratio": 1.0 + 1e-6}, {"level": 0.012}),
    "periodic_disturbance": (
        {"amplitude": 1e-4, "frequency": 17.0, "phase": 0.4},
        {"frequency": 17.0},
    ),
    "drift": (
        {"amplitude": 1e-4, "time_constant": 0.2},
        {"time_constant": 0.2, "kind": "exponential"},
    ),
}
# Share left after the best coefficients. Dry friction differs at standstill, where it holds.
FIRST_ORDER = {
    "saturation": 0.3,
    "sensor_nonlinearity": 0.3,
    "dead_zone": 0.05,
    "slew_limit": 0.3,
    "valve_stiction": 0.3,  # jumps of 1e-3 N at other samples as soon as the motion differs
    "coulomb_friction": 0.06,
    "asymmetric_friction": 0.06,
    "position_dependent_friction": 0.06,
    "stribeck_friction": 0.06,
}


def spec(name, **changed):
    return EffectSpec(name, {**PARAMETERS[name], **changed})


def numbers(parameters):
    return {k: v for k, v in parameters.items() if isinstance(v, int | float)}


@pytest.mark.parametrize("name", NAMES)
def test_regressor_is_the_first_order_of_the_simulation(name):
    effect = EFFECTS[name]
    parameters, nonlinear = SMALL[name]
    run = SIMULATOR.run((), reference())
    whole = SIMULATOR.run([EffectSpec(name, parameters)], reference()).y - run.y
    columns = SIMULATOR.respond(effect.port, effect.regressors(run.motion(), **nonlinear))
    coefficients = np.linalg.lstsq(columns, whole, rcond=None)[0]
    if effect.fixed_amount:
        coefficients = np.ones(1)
    left = np.linalg.norm(whole - columns @ coefficients) / np.linalg.norm(whole)
    assert left < FIRST_ORDER.get(name, 0.02)
    found = effect.from_coefficients(coefficients, nonlinear)
    if name == "position_dependent_friction":
        there = np.interp([0.0, 0.02], [-0.02, 0.02], found["table"]["positive"])
        assert np.allclose(there, [1.5e-4, 2e-4], rtol=0.12)
        return
    for key, value in numbers(parameters).items():
        if key != "micro_damping":
            tolerance = 0.3 if key == "static_level" else 0.08  # rests on the slowest motion
            assert found[key] == pytest.approx(value, rel=tolerance)


@pytest.mark.parametrize("name", NAMES)
def test_grid_gives_parameters_that_the_regressors_take(name):
    effect = EFFECTS[name]
    motion = SIMULATOR.run((), reference()).motion()
    grid = effect.grid(motion)
    assert len(grid) >= 1
    for point in (grid[0], grid[len(grid) // 2], grid[-1]):
        columns = effect.regressors(motion, **point)
        assert columns.shape[0] == len(motion.t)
        assert np.all(np.isfinite(columns))
        values = effect.from_coefficients(np.full(columns.shape[1], 0.5), point)
        own = {k: v for k, v in values.items() if k not in effect.options}
        assert effect.check(EffectSpec(name, own))


@pytest.mark.parametrize(
    ("name", "parameter"), [(n, p) for n in NAMES for p in numbers(PARAMETERS[n])]
)
def test_every_parameter_moves_the_output(name, parameter):
    base = SIMULATOR.run([spec(name)], reference()).y
    changed = PARAMETERS[name][parameter] * 1.01
    moved = SIMULATOR.run([spec(name, **{parameter: changed})], reference()).y
    assert np.abs(moved - base).max() > 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_says_a_sentence_with_its_numbers(name):
    effect = EFFECTS[name]
    words = effect.says(effect.check(spec(name)), STAGE)
    assert words.endswith(".")
    assert words[0].isupper()
    assert any(character.isdigit() for character in words)


@pytest.mark.parametrize("name", NAMES)
def test_describes_itself(name):
    effect = EFFECTS[name]
    assert effect.component in (
        "actuator", "plant", "transmission", "sensor", "environment", "timing",
    )  # fmt: skip
    assert effect.port in ("force", "command", "output")
    assert set(effect.siblings) <= set(EFFECTS) - {name}
    known = {"position", "velocity", "direction", "acceleration", "command", "time", "history"}
    assert set(effect.depends_on) <= known | {"temperature"}
    assert type(effect).__doc__
    for parameter in effect.parameters:
        assert parameter.lower < parameter.upper


PUSHES = ("constant_load", "cogging", "gravity_torque", "linear_stiffness", "hardening_spring",
          "preloaded_spring",          "encoder_ripple", "periodic_disturbance", "drift")  # fmt: skip


@pytest.mark.parametrize("name", sorted(set(NAMES) - set(PUSHES)))
def test_stays_put_at_zero_reference(name):
    """Without a reference and without a force of its own, nothing moves."""
    run = SIMULATOR.run([spec(name)], np.zeros(200))
    assert not run.y.any()


@pytest.mark.parametrize("name", NAMES)
def test_units_and_motor_constant(name):
    """In newton through a motor constant: the same machine, parameters of force scaled."""
    motor = Plant("motor", STAGE.system, STAGE.controller, "A", "m", physics=Physics(None, 10.0))
    effect = EFFECTS[name]

    def scaled(parameter, value):
        if parameter == "table":
            return {k: v if k == "grid" else [10 * q for q in v] for k, v in value.items()}
        return value * 10 if "F" in effect.parameter(parameter).unit else value

    newton = EffectSpec(name, {k: scaled(k, v) for k, v in PARAMETERS[name].items()})
    there = Simulator(motor).run([newton], reference()).y
    here = SIMULATOR.run([spec(name)], reference()).y
    assert np.abs(there - here).max() < 1e-9 * np.abs(here).max()
    for parameter in effect.parameters:
        if "F" in parameter.unit:
            assert parameter.unit_in(motor).startswith("N")
            assert parameter.unit_in(Plant("x", STAGE.system, input_unit="A")).startswith("A")


def test_compensation_removes_what_it_is_for():
    """Feedforward of the effect's own regressors, with its parameters, cancels friction and mass."""
    motion = Motion.of_reference(reference(), STAGE.sample_time, 2.0)
    inertia = EFFECTS["mass_change"].compensation(motion)[:, 0]
    for name, weight in (("coulomb_friction", 0.5), ("viscous_friction", 20.0)):
        effect = EFFECTS[name]
        ((key, _),) = PARAMETERS[name].items()
        machine = [EffectSpec(name, {key: weight})]
        without = SIMULATOR.run(machine, reference(), inertia).y - reference()
        column = effect.compensation(motion)[:, 0]
        with_it = SIMULATOR.run(machine, reference(), inertia + weight * column).y - reference()
        assert np.linalg.norm(with_it) < 0.1 * np.linalg.norm(without)


def test_contribution_is_what_acts():
    run = SIMULATOR.run([spec("coulomb_friction"), spec("saturation")], reference())
    assert np.abs(run.contribution[:, 0]).max() == pytest.approx(5.0)
    assert np.allclose(run.contribution[:, 1], np.clip(run.u, -6, 6) - run.u)


@pytest.mark.parametrize(
    ("unit", "constant", "output", "force"),
    [
        ("kN", 1.0, "mm", "kN"),
        ("mN m", 1.0, "deg", "mN m"),
        ("kN", 2.0, "mm", "N"),
        ("V", 1.0, "m", "N"),
        ("A", 0.5, "rad", "N m"),
        ("A", None, "m", "A"),
    ],
)
def test_a_force_is_in_the_unit_of_a_command_that_is_one(unit, constant, output, force):
    physics = Physics(None, constant)
    plant = Plant("x", STAGE.system, input_unit=unit, output_unit=output, physics=physics)
    assert EFFECTS["constant_load"].parameter("force").unit_in(plant) == force


@pytest.mark.parametrize(
    ("name", "parameters", "options", "message"),
    [
        ("coulom_friction", {"level": 1.0}, {}, "did you mean 'coulomb_friction'"),
        ("coulomb_friction", {"levl": 1.0}, {}, "did you mean 'level'"),
        ("coulomb_friction", {"level": -1.0}, {}, "must lie between 0 and inf"),
        ("coulomb_friction", {"level": float("nan")}, {}, "must be finite"),
        ("coulomb_friction", {"level": "much"}, {}, "must be a number"),
        ("coulomb_friction", {}, {}, "'level' is missing"),
        ("coulomb_friction", {"level": 1.0}, {"side": "left"}, "sensor, motor, load"),
        ("coulomb_friction", {"level": 1.0}, {"sid": "load"}, "did you mean 'side'"),
        ("coulomb_friction", {"level": 1.0}, {"mass_ratio": -1.0}, "must be a positive number"),
        ("encoder_ripple", {"amplitude": 1.0, "period": 1.0}, {"side": "load"}, "one of sensor"),
        ("asymmetric_friction", {"level_positive": 1.0, "level_negative": -2.0}, {}, "between 0"),
        (
            "stribeck_friction",
            {"coulomb_level": 2.0, "static_level": 1.0, "stribeck_velocity": 0.1},
            {},
            "lies below coulomb_level",
        ),
        ("sensor_nonlinearity", {"kind": "cliping", "level": 1.0}, {}, "clipping, rectified"),
        ("sensor_nonlinearity", {"kind": "clipping"}, {}, "needs a level above 0"),
        ("drift", {"amplitude": 1.0, "time_constant": 1.0}, {"kind": "step"}, "exponential, sine"),
        ("input_delay", {"delay": -1e-3}, {}, "between 0 and inf"),
        ("flexible_mode", {"frequency": 10.0, "mass_fraction": 1.5}, {}, "between 1e-09 and 0.999"),
        ("cogging", {"amplitude": 1.0, "period": 0.0}, {}, "must lie between 1e-12"),
        ("cogging", {"amplitude": 1.0, "period": 0.1, "phase_x": 0.0}, {}, "unknown parameter"),
        ("position_dependent_friction", {"table": [1, 2]}, {}, "must hold grid, positive"),
        (
            "position_dependent_friction",
            {"table": {"grid": [1, 0], "positive": [1, 1], "negative": [1, 1]}},
            {},
            "must rise strictly",
        ),
        (
            "position_dependent_friction",
            {"table": {"grid": [0, 1], "positive": [1, -1], "negative": [1, 1]}},
            {},
            "levels are magnitudes",
        ),
        (
            "position_dependent_friction",
            {"table": {"grid": [0, 1], "positive": [1], "negative": [1, 1]}},
            {},
            "of one length",
        ),
        (
            "position_dependent_friction",
            {"table": {"grid": [0, 1], "positive": [1, 1], "negative": [1, 1]}, "level": 3.0},
            {},
            "not the mean of the table",
        ),
    ],
)
def test_bad_entries_are_refused_in_one_line(name, parameters, options, message):
    with pytest.raises(InputError, match=message) as caught:
        check_effects(Plant("p", STAGE.system, effects=(EffectSpec(name, parameters, options),)))
    assert "\n" not in str(caught.value)
    assert "effects[0]" in str(caught.value)


def test_force_effects_need_a_moving_mass():
    from ffl.systems.state_space import StateSpace

    tank = Plant("tank", StateSpace([[0.98]], [[-0.1]], [[1.0]], 0.0, 4.0))
    with pytest.raises(InputError, match="no moving mass at that point"):
        Simulator(tank).run([EffectSpec("coulomb_friction", {"level": 1.0})], np.zeros(5))
    with pytest.raises(InputError, match="no mode"):
        Simulator(tank).run([EffectSpec("mass_change", {"change": 1.0})], np.zeros(5))


def test_plant_file_keeps_effects_and_their_options(tmp_path):
    effects = (
        EffectSpec("coulomb_friction", {"level": 2.0}, {"side": "motor"}),
        spec("position_dependent_friction"),
        spec("cogging"),
    )
    plant = Plant("kept", STAGE.system, STAGE.controller, "N", "m", effects=effects)
    save_plant(plant, tmp_path / "kept.toml")
    back = load_plant(tmp_path / "kept.toml")
    check_effects(back)
    one = SimulatedMachine(plant).run(reference(), None, np.random.default_rng(0))
    two = SimulatedMachine(back).run(reference(), None, np.random.default_rng(0))
    assert np.array_equal(one.y, two.y)
    assert back.effects[0].options["side"] == "motor"


PLACES = {
    "actuator": (
        "cogging",
        "position_dependent_gain",
        "saturation",
        "dead_zone",
        "slew_limit",
        "input_delay",
        "actuator_lag",
    ),
    "transmission": ("backlash",),
    "sensor": ("encoder_ripple", "sensor_nonlinearity", "sensor_bend", "sensor_lead"),
    "environment": ("constant_load", "periodic_disturbance", "drift"),
}


@pytest.mark.parametrize(("place", "name"), [(p, n) for p, names in PLACES.items() for n in names])
def test_an_effect_is_located_where_the_contract_says(place, name):
    assert EFFECTS[name].component == place


@pytest.mark.parametrize(("stiffness", "spoken"), [(30.0, True), (5.0, False), (-30.0, False)])
def test_a_table_speaks_of_the_spring_that_may_be_in_it(stiffness, spoken):
    grid = np.linspace(-0.1, 0.1, 9)
    even, force = 5.0 + np.cos(40.0 * grid), stiffness * (grid - 0.02)
    table = {"grid": grid, "positive": even + force, "negative": even - force}
    table = {key: value.tolist() for key, value in table.items()}
    effect = EFFECTS["position_dependent_friction"]
    words = effect.says(effect.check(EffectSpec(effect.name, {"table": table})), STAGE)
    assert ("as by a spring of 30 N/m about 0.02 m" in words) is spoken


def test_an_output_that_does_not_move_has_no_springs():
    heater = plant_from_dict(
        {
            "name": "furnace", "sample_time": 10.0, "units": {"input": "W", "output": "°C"},
            "plant": {"form": "czpk", "zeros": [], "poles": [-0.01], "gain": 0.01},
        }
    )  # fmt: skip
    for name, words in (
        ("hardening_spring", "What drives the output back grows with the cube"),
        ("constant_load", "acts beside the input"),
        ("linear_stiffness", "more drive the output towards"),
    ):
        effect = EFFECTS[name]
        assert words in effect.says(effect.check(spec(name)), heater)
        assert words not in effect.says(effect.check(spec(name)), STAGE)


@pytest.mark.parametrize(("cubic", "what"), [(2.0, "hardens"), (-2.0, "softens")])
def test_a_cubic_spring_says_which_way_it_bends(cubic, what):
    effect = EFFECTS["hardening_spring"]
    spring = EffectSpec(effect.name, {"cubic_coefficient": cubic, "centre": 0.0})
    words = effect.says(effect.check(spring), STAGE)
    assert words.startswith(f"A spring {what} with the cube")
    assert words.endswith(": 2 N/m^3.")
