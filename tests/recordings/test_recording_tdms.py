"""TDMS files: names, units, clocks, and what is refused."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.recordings import read_recording
from ffl.recordings.readers import open_table

nptdms = pytest.importorskip("nptdms")

N = 30
START = np.datetime64("2024-05-06T08:00:00.000000")


def clock(step=0.01, start=START, offset=0.0, **more):
    return {"wf_increment": step, "wf_start_time": start, "wf_start_offset": offset, **more}


def write(path, channels, segments=1):
    """Channels as (group, name): (values, properties), in so many segments one after another."""
    with nptdms.TdmsWriter(path) as file:
        for k in range(segments):
            file.write_segment(
                [
                    nptdms.ChannelObject(*place, np.array_split(values, segments)[k], properties)
                    for place, (values, properties) in channels.items()
                ]
            )
    return path


def two(u=None, y=None, group="g"):
    return {
        (group, "u"): (np.arange(N) + 0.5, clock() if u is None else u),
        (group, "y"): (np.arange(N) + 1.5, clock(unit_string="mm") if y is None else y),
    }


@pytest.mark.parametrize("segments", [1, 3])
def test_time_from_the_waveform_and_units(tmp_path, segments):
    x = read_recording(write(tmp_path / "x.tdms", two(), segments))
    assert (x.sample_time, x.t[0]) == (0.01, 0.0)
    assert np.array_equal(x.u, np.arange(N) + 0.5)
    assert np.array_equal(x.y, np.arange(N) + 1.5)
    assert dict(x.units) == {"t": "s", "y": "mm"}
    shifted = two(u=clock(offset=2.0), y=clock(offset=2.0))
    assert read_recording(write(tmp_path / "y.tdms", shifted)).t[0] == 2.0


def test_a_channel_called_t_comes_first_and_dates_are_seconds(tmp_path):
    t = 5.0 + 0.02 * np.arange(N)
    x = read_recording(write(tmp_path / "x.tdms", {("g", "t"): (t, {}), **two()}))
    assert np.array_equal(x.t, t)
    stamps = START + (20_000 * np.arange(N)).astype("m8[us]")
    x = read_recording(write(tmp_path / "y.tdms", {("g", "t"): (stamps, {}), **two()}))
    assert (x.t[0], x.sample_time) == (8 * 3600.0, 0.02)


def test_a_name_in_two_groups_needs_its_group(tmp_path):
    path = write(tmp_path / "x.tdms", {**two(), ("other", "y"): (-np.arange(N), clock())})
    with pytest.raises(InputError, match=r"no column y.*there is u, g\.y, other\.y, t"):
        read_recording(path)
    (tmp_path / "x.map.toml").write_text('[columns]\nt = "t"\nu = "g.u"\ny = "other.y"\n')
    assert np.array_equal(read_recording(path).y, -np.arange(N))
    table = open_table(path)
    assert table.find("g.u") == table.find("u") == "u"


def test_channels_not_asked_for_may_be_on_any_clock(tmp_path):
    gain = {("g", "gain"): (np.array([3.0]), {}), ("g", "slow"): (np.ones(3), clock(0.1))}
    path = write(tmp_path / "x.tdms", {**two(), **gain})
    (tmp_path / "x.map.toml").write_text(
        '[columns]\nt = "t"\nu = { name = "u", times = "gain" }\ny = "y"\n'
    )
    x = read_recording(path)
    assert np.array_equal(x.u, 3 * (np.arange(N) + 0.5))
    assert x.sample_time == 0.01
    (tmp_path / "x.map.toml").write_text('sample_time = 0.5\n[columns]\nu = "u"\ny = "y"\n')
    assert read_recording(path).sample_time == 0.5


@pytest.mark.parametrize(
    ("channels", "said"),
    [
        (two(y=clock(0.02)), "'u' and 'y' are sampled on different clocks; resample"),
        (two(y=clock(start=START + np.timedelta64(200, "us"))), "different clocks"),
        (two(y=clock(start=START + np.timedelta64(1, "s"))), "different clocks"),
        (two(y=clock(offset=0.005)), "different clocks"),
        ({**two(u={}, y={}), ("g", "x"): (np.ones(3), clock())}, "'u' has no wf_increment; leave t out"),
        (two(u={}, y={}), "no time column t; add it, or give sample_time"),
        (two(u=clock(0.0), y=clock(-1.0)), "no time column t"),
        ({("g", "y"): (np.array(["a"] * N), clock())}, "'y' does not hold real numbers"),
        ({**two(), ("g", "y"): (np.arange(N - 1.0), clock())}, r"unequal lengths \(t 30, u 30, y 29\)"),
        ({**two(), ("g", "y"): (np.full(N, np.nan), clock())}, "sample 0, column y: nan"),
        ({}, "cannot be read as a TDMS file|no channel in this TDMS file; save it again"),
    ],
)  # fmt: skip
def test_refused_in_one_line(tmp_path, channels, said, refused):
    path = write(tmp_path / "x.tdms", channels)
    refused(path, said)


def test_a_skew_below_a_hundredth_of_the_sample_time_is_one_clock(tmp_path):
    """20 us of 10 ms; the start time is exact to far less than numpy's microseconds."""
    channels = two(y=clock(start=START + np.timedelta64(20, "us")))
    assert read_recording(write(tmp_path / "x.tdms", channels)).sample_time == 0.01


def test_cut_off_at_any_byte_is_refused(tmp_path):
    whole = write(tmp_path / "x.tdms", two(), 2).read_bytes()
    path = tmp_path / "cut.tdms"
    ends = {whole.index(b"TDSm", 1)}  # after the first segment nothing tells that another followed
    for end in sorted({*range(1, len(whole), 7), len(whole) - 1} - ends):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match=r"cut off in its last segment|cannot be read"):
            read_recording(path)


def test_the_library_prints_nothing_beside_our_line(tmp_path, caplog):
    """An unknown version of the format: npTDMS would warn, and reads it."""
    path = write(tmp_path / "x.tdms", two())
    content = bytearray(path.read_bytes())
    content[8:12] = (9).to_bytes(4, "little")
    path.write_bytes(content)
    assert len(read_recording(path)) == N
    assert not caplog.records
