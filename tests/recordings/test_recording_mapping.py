"""Mapping files: what they can say, what they refuse, and the shipped ones on the real data."""

import numpy as np
import pytest
import scipy.io

from ffl.errors import InputError
from ffl.recordings import check_recording, load_mapping, read_recording, read_recordings, soundness
from ffl.systems.plant_file import load_plant, shipped_plants


@pytest.fixture
def mat(tmp_path):
    """A file as a lab leaves it: a struct, two axes in one table, a gain, a clock in ms."""
    n = 50
    k = np.arange(n, dtype=float)
    content = {
        "log": {"ms": 2 * k, "q": np.stack([k, -k]), "volts": k % 5, "load": k**2},
        "gain": 3.0,
    }
    scipy.io.savemat(tmp_path / "lab.mat", content)
    return tmp_path / "lab.mat"


BASE = """
[columns]
t = { name = "log.ms", scale = 0.001 }
y = { name = "log.q", index = 1, scale = -2.0, offset = 1.0, unit = "m" }
u = { name = "log.volts", times = "gain", unit = "N" }
[columns.d]
sum = [
    "log.load",
    { name = "log.volts", scale = -1.0, times = [{ name = "log.q", index = 0 }, "gain"] },
]
"""

Y = next(line for line in BASE.splitlines() if line.startswith("y = "))


def rules(path, text):
    (path.parent / f"{path.stem}.map.toml").write_text(text)
    return path


def test_a_mapping_that_lies_beside_is_named_where_it_does_not_fit(mat):
    with pytest.raises(InputError, match=r"no column 'log.s'.*the mapping is .*lab.map.toml"):
        read_recording(rules(mat, BASE.replace("log.ms", "log.s")))


def test_time_in_milliseconds_is_told_from_another_sample_time(mat):
    file = rules(mat, BASE.replace('"log.ms", scale = 0.001', '"log.ms"'))
    with pytest.raises(InputError, match=r"t is in ms; give t a scale = 0.001"):
        check_recording(read_recording(file), 0.002)
    with pytest.raises(InputError, match="resample the recording"):
        check_recording(read_recording(file), 0.003)


def test_scale_offset_index_product_and_sum(mat):
    x = read_recording(rules(mat, BASE))
    k = np.arange(50.0)
    assert x.sample_time == 0.002
    assert np.array_equal(x.y, 2 * k + 1)
    assert np.array_equal(x.u, 3 * (k % 5))
    assert np.array_equal(x.d, k**2 - (k % 5) * k * 3)
    assert dict(x.units) == {"y": "m", "u": "N"}
    assert x.missing == {"r", "f"}


def test_several_recordings_rows_and_start(mat):
    text = """
    sample_time = 0.5
    start = 10.0
    rows = [0, 30]
    default = "second"
    [columns]
    u = "log.volts"
    [[recordings]]
    name = "first"
    columns = { y = { name = "log.q", index = 0 } }
    [[recordings]]
    name = "second"
    rows = [20]
    columns = { y = { name = "log.q", index = 1 }, r = { constant = 4.0 } }
    """
    path = rules(mat, text)
    first, second = read_recordings(path)
    assert len(first) == 30
    assert first.t[0] == 10.0
    assert first.source.endswith("lab.mat::first")
    assert np.array_equal(second.y, -np.arange(20.0, 50.0))
    assert second.t[0] == 20.0
    assert set(second.r) == {4.0}
    assert np.array_equal(read_recording(path).y, second.y)
    assert np.array_equal(read_recording(f"{path}::first").y, first.y)
    assert np.array_equal(read_recording(path, name="first").y, first.y)
    assert len(read_recordings(f"{path}::first")) == 1
    with pytest.raises(InputError, match="no recording 'fist'; did you mean 'first'"):
        read_recording(f"{path}::fist")
    rules(mat, text.replace('default = "second"', ""))
    with pytest.raises(InputError, match=r"several recordings \(first, second\); pick one"):
        read_recording(path)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[columns]", "sampletime = 1.0\n[columns]", "unknown key 'sampletime'.*'sample_time'"),
        ("offset = 1.0", "ofset = 1.0", r"unknown key 'columns\.y\.ofset'.*'offset'"),
        ("index = 1,", "index = 2,", r"index = 2 is too large; give index = 0 to 1"),
        ("index = 1,", "", "'log.q' holds 2 signals of 50 samples; give index"),
        ('"log.volts", times', '"log.volts", index = 0, times', "leave index out"),
        ('name = "log.volts", times = "gain"', 'name = "log.volt"', "did you mean 'log.volts'"),
        ('name = "log.volts", times = "gain"', "constant = 1.0, scale = 2.0", "go with name"),
        ('name = "log.volts", times = "gain"', 'name = "x", constant = 1.0', "exactly one of"),
        ("scale = 0.001", "scale = inf", "finite"),
        ("[columns]", "rows = [5, 2]\n[columns]", "rows.*start < stop"),
        ("[columns]", "rows = [5, 200]\n[columns]", r"rows = \[5, 200\] reach beyond its 50"),
        ("[columns]", "rows = [5, 8]\n[columns]", "3 samples are too few"),
        ("[columns]", "sample_time = 0.0\n[columns]", "greater than 0"),
        ("[columns]", "sample_time = 0.1\n[columns]", "the mapping says 0.1 s"),
        ("[columns]", 'default = "a"\n[columns]', "default is none of the recordings"),
        (Y, "", "no column y"),
        (Y[4:], "{ constant = 1.0 }", "cannot be a constant"),
        ("[columns]", "[columns", "lab.map.toml"),
    ],
)  # fmt: skip
def test_refused_in_one_line(mat, old, new, said):
    assert old in BASE
    with pytest.raises(InputError, match=said) as error:
        read_recording(rules(mat, BASE.replace(old, new, 1)))
    assert "\n" not in str(error.value)


def test_same_name_twice(mat):
    part = '[[recordings]]\nname = "a"\n'
    with pytest.raises(InputError, match="two recordings have one name"):
        read_recording(rules(mat, BASE + part + part))


def test_mapping_that_is_not_there(mat, tmp_path):
    with pytest.raises(InputError, match="did you mean 'emps'"):
        read_recording(mat, "empss")
    with pytest.raises(InputError, match="no such file"):
        read_recording(mat, tmp_path / "none.toml")


def test_every_shipped_mapping_is_valid_and_says_what_it_is():
    names = sorted(p.stem for p in (shipped_plants() / "maps").glob("*.toml"))
    assert names == sorted({name for name, *_ in SHIPPED})
    for name in names:
        assert load_mapping(name).about


KUKA = "kuka_kr300/FF_A_08ms.mat"
SHIPPED = [
    ("emps", "emps/DATA_EMPS.mat", [24841], 1e-3, ("N", "m"), {"f"}),
    ("emps", "emps/DATA_EMPS_PULSES.mat", [24841], 1e-3, ("N", "m"), set()),
    ("silverbox", "silverbox/SNLS80mV.mat", [86800, 40400], 2**14 * 1e-7, ("V", "V"), {"clock"}),
    ("silverbox_schroeder", "silverbox/Schroeder80mV.mat", [131072], 2**14 * 1e-7, ("V", "V"), {"clock"}),
    ("ced_uniform", "ced/DATAUNIF.csv", [500, 500, 300, 300, 200, 200], 0.02, ("V", "ticks/s"), {"clock"}),
    ("ced_prbs", "ced/DATAPRBS.csv", [500, 500, 500], 0.02, ("V", "ticks/s"), {"clock"}),
    ("cascaded_tanks", "cascaded_tanks/dataBenchmark.csv", [1024, 1024], 4.0, ("V", "V"), {"clock"}),
    *[
        (f"kuka_axis{k}", KUKA, [2501] * (3 if k < 4 else 1), 0.004, ("N m", "rad"), {"f"})
        for k in range(1, 7)
    ],
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "file", "lengths", "sample_time", "units", "missing"),
    SHIPPED,
    ids=[f"{name}-{file.split('/')[-1]}" for name, file, *_ in SHIPPED],
)
def test_shipped_mapping_reads_its_data(real, name, file, lengths, sample_time, units, missing):
    recordings = read_recordings(real(file), name)
    assert [len(x) for x in recordings] == lengths
    missing = {"t", "r", "f"} if missing == {"clock"} else missing
    for x in recordings:
        assert x.sample_time == pytest.approx(sample_time, rel=1e-12)
        assert (x.units["u"], x.units["y"]) == units
        assert x.missing == missing
        found = soundness(x)
        assert found.sound, found.faults
        kinds = {f.kind for f in found.findings if f.severity == "warning"}
        assert kinds == ({"clipped"} if name == "cascaded_tanks" else set())


@pytest.mark.parametrize(("file", "left"), [("DATA_EMPS", 0.13), ("DATA_EMPS_PULSES", 0.17)])
def test_emps_command_is_feedforward_plus_the_stated_servo_law(real, file, left):
    """u = f + C_r r - C_y y to 0.13 N RMS (3.7 mV); with the pulses as 5 V it would be 2.5 N."""
    x = read_recording(real(f"emps/{file}.mat"), "emps", sample_time=1e-3)
    servo = load_plant("emps").controller
    feedback = servo.reference.filter(x.r) - servo.output.filter(x.y)
    assert np.std((x.u - x.f - feedback)[5:]) < left
    assert (np.std((x.u - feedback)[5:]) < left) == (file == "DATA_EMPS")


def test_optional_column(mat):
    """As if it were not mapped where the file lacks it; a name that is there is read."""
    text = BASE.replace("[columns.d]", 'r = "log.load"\nf = {%s, optional = true}\n[columns.d]')
    absent = read_recording(rules(mat, text % 'name = "log.pulses"'))
    there = read_recording(rules(mat, text % 'name = "log.volts"'))
    assert "f" in absent.missing
    assert not absent.f.any()
    assert any("optional" in note for note in absent.notes)
    assert "f" not in there.missing
    assert there.f.any()
    with pytest.raises(InputError, match="leave optional out"):
        read_recording(rules(mat, text % "constant = 0.0"))


@pytest.mark.parametrize("axis", range(1, 6))
def test_kuka_known_load_explains_torque_with_this_sign(real, axis):
    """u + d leaves less than u - d and than u after inertia, viscous and Coulomb friction."""
    from scipy.signal import savgol_filter

    x = read_recording(real(KUKA), f"kuka_axis{axis}")
    v, a = (savgol_filter(x.y, 41, 4, deriv=k, delta=x.sample_time) for k in (1, 2))
    model = np.column_stack([a, v, np.sign(v), np.ones(len(v))])

    def left(torque):
        return np.std(torque - model @ np.linalg.lstsq(model, torque, rcond=None)[0])

    assert left(x.u + x.d) < 0.96 * left(x.u)
    assert left(x.u + x.d) < 0.96 * left(x.u - x.d)


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_kuka_both_encoders_are_those_of_motor_and_arm(real, axis):
    both, motor, arm = (
        read_recording(f"{real(KUKA)}::{name}", f"kuka_axis{axis}")
        for name in ("both", "motor", "arm")
    )
    assert np.array_equal(both.y, motor.y)
    assert np.array_equal(both.y_load, arm.y)
    assert both.units["y_load"] == "rad"
