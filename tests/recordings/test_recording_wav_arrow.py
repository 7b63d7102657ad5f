"""WAV and Arrow files: full scale, dates, and what is refused."""

import numpy as np
import pytest
from scipy.io import wavfile

from ffl.errors import InputError
from ffl.recordings import read_recording

N = 40
MAP = '[columns]\n{}u = "channel_1"\ny = "channel_2"\n'


@pytest.mark.parametrize(
    ("kind", "values", "wanted"),
    [
        (np.int16, [-(2**15), 0, 2**14], [-1.0, 0.0, 0.5]),
        (np.int32, [-(2**31), 0, 2**30], [-1.0, 0.0, 0.5]),
        (np.uint8, [0, 128, 192], [-1.0, 0.0, 0.5]),
        (np.float32, [-1.5, 0.0, 0.5], [-1.5, 0.0, 0.5]),
        (np.float64, [-1.5, 0.0, 1e-12], [-1.5, 0.0, 1e-12]),
    ],
)
def test_full_scale_is_one(tmp_path, kind, values, wanted):
    samples = np.resize(np.array(values, kind), N)
    wavfile.write(tmp_path / "x.wav", 8000, np.column_stack([samples[::-1], samples]))
    (tmp_path / "x.map.toml").write_text(MAP.format('t = "t"\n'))
    x = read_recording(tmp_path / "x.wav")
    assert np.array_equal(x.y, np.resize(wanted, N))
    assert np.array_equal(x.u, x.y[::-1])
    assert (x.sample_time, x.t[0]) == (1.25e-4, 0.0)


def test_twenty_four_bits(tmp_path):
    """Three bytes a sample, least first; scipy writes none, so they are put together here."""
    samples = np.array([-(2**23), 2**22] * N, "<i4")
    data = b"".join(int(v).to_bytes(3, "little", signed=True) for v in samples)
    form = b"".join(
        int(v).to_bytes(n, "little")
        for v, n in ((1, 2), (2, 2), (8000, 4), (48000, 4), (6, 2), (24, 2))
    )
    body = b"WAVE" + b"fmt \x10\0\0\0" + form + b"data" + len(data).to_bytes(4, "little") + data
    (tmp_path / "x.wav").write_bytes(b"RIFF" + len(body).to_bytes(4, "little") + body)
    (tmp_path / "x.map.toml").write_text(MAP.format('t = "t"\n'))
    x = read_recording(tmp_path / "x.wav")
    assert set(x.u) == {-1.0}
    assert set(x.y) == {0.5}


def test_a_sample_time_of_the_mapping_is_taken_and_must_agree_with_the_rate(tmp_path):
    wavfile.write(tmp_path / "x.wav", 8000, np.ones((N, 2), np.int16))
    (tmp_path / "x.map.toml").write_text("sample_time = 0.5\n" + MAP.format(""))
    assert read_recording(tmp_path / "x.wav").sample_time == 0.5
    (tmp_path / "x.map.toml").write_text("sample_time = 0.5\n" + MAP.format('t = "t"\n'))
    with pytest.raises(InputError, match=r"0\.000125 s, the mapping says 0\.5 s"):
        read_recording(tmp_path / "x.wav")


def test_a_bad_wav_is_refused(tmp_path):
    path = tmp_path / "x.wav"
    wavfile.write(path, 8000, np.ones(N, np.int16))
    whole = path.read_bytes()
    with pytest.raises(InputError, match=r"no column y.*there is t, channel_1\)"):
        read_recording(path)
    for end in range(1, len(whole) - 1):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match=r"cut off; export|cannot be read as a WAV file"):
            read_recording(path)
    wavfile.write(path, 8000, np.zeros((0, 2), np.int16))
    with pytest.raises(InputError, match="no sample in this WAV file; record it again"):
        read_recording(path)


def arrow(path, **columns):
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table({k: pyarrow.array(v) for k, v in columns.items()})
    with pyarrow.ipc.new_file(path, table.schema) as file:
        file.write_table(table, max_chunksize=7)
    return path


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_of_arrow_are_seconds(tmp_path, unit):
    t = np.datetime64("2024-02-28T23:59:50", unit) + np.arange(N).astype("m8[s]")
    x = read_recording(arrow(tmp_path / "x.arrow", t=t, u=np.arange(N), y=np.arange(N) % 2 == 0))
    assert (x.t[0], x.t[-1], x.sample_time) == (86390.0, 86390.0 + N - 1, 1.0)
    assert np.array_equal(x.u, np.arange(N))
    assert np.array_equal(x.y, np.arange(N) % 2 == 0)
    x = read_recording(arrow(tmp_path / "y.feather", t=t - t[0], u=np.ones(N), y=np.ones(N)))
    assert (x.t[0], x.sample_time) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("y", "said"),
    [
        ([1.0, None] * (N // 2), "sample 1, column y: nan"),
        (["a"] * N, "'y' does not hold real numbers"),
        ([[1.0, 2.0]] * N, "'y' does not hold real numbers"),
        ([*np.arange(N - 1).astype("M8[s]").tolist(), None], "sample 39, column y: nan"),
    ],
)  # fmt: skip
def test_columns_of_arrow_that_are_refused(tmp_path, y, said):
    path = arrow(tmp_path / "x.arrow", t=0.01 * np.arange(N), u=np.ones(N), y=y)
    with pytest.raises(InputError, match=said):
        read_recording(path)


def test_a_cut_off_arrow_file_is_refused(tmp_path):
    path = arrow(tmp_path / "x.arrow", t=0.01 * np.arange(N), u=np.ones(N), y=np.ones(N))
    whole = path.read_bytes()
    for end in range(1, len(whole), 11):
        path.write_bytes(whole[:end])
        with pytest.raises(InputError, match="cannot be read as an Arrow file") as error:
            read_recording(path)
        assert "\n" not in str(error.value)
