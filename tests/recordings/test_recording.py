"""The recording itself: what is filled in, cutting, writing, reading back."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ffl.errors import InputError
from ffl.recordings import Recording, read_recording, shared_clock, write_recording

FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


def test_open_loop_command_is_the_feedforward():
    x = Recording.from_signals(0.1, y=np.arange(5.0), u=np.ones(5))
    assert np.array_equal(x.f, x.u)
    assert not x.r.any()
    assert x.missing == {"t", "r", "f"}
    assert x.is_open_loop
    x = Recording.from_signals(0.1, y=np.arange(5.0), f=np.ones(5))
    assert np.array_equal(x.u, x.f)
    assert x.missing == {"t", "r", "u"}


def test_closed_loop_without_feedforward_has_none():
    x = Recording.from_signals(0.1, y=np.zeros(5), u=np.ones(5), r=np.arange(5.0))
    assert not x.f.any()
    assert x.missing == {"t", "f"}
    assert not x.is_open_loop


def test_command_that_only_the_controller_knows_is_nan_until_given():
    x = Recording.from_signals(0.1, y=np.zeros(5), f=np.ones(5), r=np.arange(5.0))
    assert np.isnan(x.u).all()
    assert x.missing == {"t", "u"}
    whole = x.with_command(2 * x.error)
    assert np.array_equal(whole.u, 1 + 2 * np.arange(5.0))
    assert whole.missing == x.missing
    assert any("computed" in note for note in whole.notes)


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ({"y": np.zeros(3)}, "nothing says what drove"),
        ({"y": np.zeros(3), "u": np.zeros(4)}, "unequal lengths"),
        ({"y": np.zeros((3, 2)), "u": np.zeros(3)}, "shape"),
        ({"y": np.zeros(3), "u": np.array(["a", "b", "c"])}, "real numbers"),
        ({"y": np.zeros(3), "u": 1j * np.zeros(3)}, "real numbers"),
        ({"y": [[0.0], [1.0, 2.0]], "u": np.zeros(2)}, "real numbers"),
    ],
)
def test_refused(signals, said):
    with pytest.raises(InputError, match=said):
        Recording.from_signals(0.1, **signals)


@pytest.mark.parametrize("sample_time", [0.0, -1.0, np.nan, np.inf])
def test_sample_time_refused(sample_time):
    with pytest.raises(InputError, match="positive"):
        Recording.from_signals(sample_time, y=np.zeros(3), u=np.zeros(3), t=np.arange(3.0))


def test_cuts_by_index_and_time(recording, same_bits):
    part = recording[100:200]
    assert len(part) == 100
    assert part.duration == pytest.approx(0.1)
    assert part.t[0] == recording.t[100]
    again = recording.between(part.t[0], recording.t[200])
    assert same_bits(again.y, part.y)
    assert len(recording[-5:]) == 5
    with pytest.raises(InputError, match="no sample"):
        recording[10:10]
    with pytest.raises(InputError, match="no sample between"):
        recording.between(100.0, 200.0)
    with pytest.raises(TypeError):
        recording[::2]


def test_clock_is_shared_where_recordings_follow_one_another(recording):
    assert shared_clock([recording[2000:], recording[:2000]])
    assert not shared_clock([recording[1500:], recording[:2000]])
    assert not shared_clock([recording, recording])


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_csv_gives_back_the_same_bits(tmp_path, same_bits, data):
    n = data.draw(st.integers(10, 40))
    columns = {
        name: data.draw(st.none() if name in gone else arrays(float, n, elements=FINITE))
        for gone in [data.draw(st.sets(st.sampled_from(["r", "f", "d", "y_load"])))]
        for name in ("u", "y", "r", "f", "d", "y_load")
    }
    start = data.draw(st.floats(-1e3, 1e3))
    sample_time = data.draw(st.sampled_from([1e-4, 1e-3, 1 / 3, 0.004, 0.0016384, 4.0]))
    t = start + sample_time * np.arange(n)
    before = Recording.from_signals(sample_time, t=t, **columns)
    write_recording(before, tmp_path / "x.csv")
    after = read_recording(tmp_path / "x.csv")
    assert after.missing == before.missing
    assert after.sample_time == pytest.approx(sample_time, rel=1e-9)
    for name in ("t", "r", "f", "u", "y"):
        assert same_bits(getattr(after, name), getattr(before, name)), name
    for name in ("d", "y_load"):
        there = getattr(after, name)
        assert (there is None) == (getattr(before, name) is None)
        if there is not None:
            assert same_bits(there, getattr(before, name))


def test_written_whole_or_not_at_all(tmp_path, recording, monkeypatch):
    path = tmp_path / "x.csv"
    write_recording(recording[:20], path)
    old = path.read_bytes()

    def fails(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", fails)
    with pytest.raises(OSError, match="disk full"):
        write_recording(recording, path)
    assert path.read_bytes() == old
    assert [p.name for p in tmp_path.iterdir()] == ["x.csv"]
    with pytest.raises(InputError, match=r"\.csv"):
        write_recording(recording, tmp_path / "x.mat")
