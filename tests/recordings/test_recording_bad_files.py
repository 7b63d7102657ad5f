"""Whatever is wrong with a file is one line that says what, where and how to mend."""

from importlib import import_module
from importlib.util import find_spec

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ffl.errors import InputError
from ffl.recordings import READERS, read_recording, write_recording

N = 40


def table(rows=None, header="t,r,f,u,y"):
    rows = rows or [f"{0.001 * k:.3f},0,{k},{k + 1},{k * k}" for k in range(N)]
    return header + "\n" + "\n".join(rows) + "\n"


def edited(row, text):
    rows = [f"{0.001 * k:.3f},0,{k},{k + 1},{k * k}" for k in range(N)]
    rows[row] = text
    return table(rows)


def cut(*gone):
    rows = [f"{0.001 * k:.3f},0,{k},{k + 1},{k * k}" for k in range(N) if k not in gone]
    return table(rows)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "empty"),
        ("\n\n  \n", "empty"),
        ("t,r,f,u,y\n", "no sample below the header"),
        ("t,r,f,u,y", "no sample below the header"),
        (table(["0,0,0,0,0", "1,0,0,0,0"]), "2 samples are too few"),
        (table().split("\n", 1)[1], "line 1 holds numbers where the header"),
        (table(header="t,r,f,u"), "the rows have 5 columns, the header names 4"),
        (table(header="t,r,f,u,y,z"), "the rows have 5 columns, the header names 6"),
        (table(header="t,r,f,u,Y"), "no column y.*there is t, r, f, u, Y"),
        (table(header="t,r,f,y,y"), "'y' stands there 2 times"),
        (table(header="t,r,f,y [m],y [mm]"), "'y' stands there 2 times"),
        (table(header="x,r,f,u,y"), "no time column t"),
        (table(header="t,a,b,c,y"), "nothing says what drove"),
        (edited(7, "0.007,0,7,8"), "line 9 has 4 columns, the lines before have 5"),
        (edited(7, "0.007,0,7,8,49,1"), "line 9 has 6 columns"),
        (edited(7, ""), "line 9 has 1 columns"),
        (table()[:-8], "line 41 has 4 columns.*cut off"),
        (edited(7, "0.007,0,7,8,"), "line 9, column y: there is no value"),
        (edited(7, "0.007,0,7,x8,49"), "line 9, column u: 'x8' is not a number"),
        (edited(7, "0.007,0,7,1_0,49"), "line 9, column u: '1_0' is not a number"),
        (edited(7, "0.007,0,7,nan,49"), "line 9, column u: nan"),
        (edited(7, "0.007,0,7,8,-inf"), "line 9, column y: -inf"),
        (edited(7, "0.007,0,7,8,1e999"), "line 9, column y: inf"),
        (edited(7, "0.005,0,7,8,49"), r"line 9, column t: time runs backwards \(0.006 s to 0.005"),
        (edited(7, "0.006,0,7,8,49"), "line 9, column t: time stands still"),
        (edited(7, "0.0073,0,7,8,49"), "line 9, column t: intervals differ .* by up to 30 %"),
        (edited(7, "0.007005,0,7,8,49"), "line 9, column t: intervals differ .* by up to 0.5 %"),
        (cut(7, 8), "line 9, column t: 2 samples missing between 0.006 s and 0.009 s"),
        (cut(7, 20, 21), "1 sample missing.*2 gaps with 3 samples in all"),
    ],
)
def test_csv(tmp_path, content, said, refused):
    path = tmp_path / "x.csv"
    path.write_text(content)
    refused(path, said)


def test_files_that_are_none(tmp_path):
    for name, said in (("x.csv", "no such file"), ("x.docx", "no such file")):
        with pytest.raises(InputError, match=said):
            read_recording(tmp_path / name)
    (tmp_path / "x.docx").write_text("x")
    with pytest.raises(InputError, match=r"'\.docx' are not read; give one of \.csv"):
        read_recording(tmp_path / "x.docx")
    (tmp_path / "f.csv").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_recording(tmp_path / "f.csv")


def test_a_bare_mat_file_and_what_is_no_signal(tmp_path):
    path = tmp_path / "x.mat"
    scipy.io.savemat(path, {})
    with pytest.raises(InputError, match="no variable"):
        read_recording(path)
    scipy.io.savemat(path, {"y": "text", "u": np.arange(20.0)})
    with pytest.raises(InputError, match="'y' does not hold real numbers"):
        read_recording(path, sample_time=1.0)
    scipy.io.savemat(path, {"y": 1j * np.arange(20.0), "u": np.arange(20.0)})
    with pytest.raises(InputError, match="'y' does not hold real numbers"):
        read_recording(path, sample_time=1.0)
    scipy.io.savemat(path, {"y": np.arange(20.0), "u": np.arange(21.0)})
    with pytest.raises(InputError, match="unequal lengths"):
        read_recording(path, sample_time=1.0)
    scipy.io.savemat(path, {"y": np.ones((2, 3, 4)), "u": np.arange(21.0)})
    with pytest.raises(InputError, match="3 dimensions"):
        read_recording(path, sample_time=1.0)
    scipy.io.savemat(path, {"y": np.zeros(0), "u": np.zeros(0)})
    with pytest.raises(InputError, match="0 samples"):
        read_recording(path, sample_time=1.0)
    with h5py.File(tmp_path / "x.h5", "w"):
        pass
    with pytest.raises(InputError, match="no data set"):
        read_recording(tmp_path / "x.h5")
    np.savez(tmp_path / "x.npz")
    with pytest.raises(InputError, match="no array"):
        read_recording(tmp_path / "x.npz")
    np.savez(tmp_path / "o.npz", y=np.array([{}]), u=np.arange(20.0))
    with pytest.raises(InputError, match="cannot be read as an NPZ file"):
        read_recording(tmp_path / "o.npz", sample_time=1.0)


def test_sample_time_within_a_thousandth(tmp_path, recording):
    path = tmp_path / "x.csv"
    write_recording(recording, path)
    assert read_recording(path, sample_time=1.0009e-3).sample_time == 1e-3
    with pytest.raises(InputError, match=r"is 0\.001 s, not 0\.002 s"):
        read_recording(path, sample_time=2e-3)


@pytest.mark.parametrize(
    "t",
    [
        1e-3 * np.arange(1000),
        np.round(1.6384e-3 * np.arange(1000), 4),
        (1e-3 * np.arange(1000)).astype(np.float32).astype(float),
        1.7e9 + np.round(1e-2 * np.arange(1000), 6),
        50 + np.cumsum(1e-3 * (1 + 4e-4 * np.sin(np.arange(1000)))),
    ],
    ids=["exact", "four digits", "single precision", "epoch", "jitter below a thousandth"],
)
def test_rounded_time_is_accepted(tmp_path, t):
    table = np.column_stack([t, np.sin(t), np.cos(t)])
    np.savetxt(tmp_path / "x.csv", table, "%.17g", ",", header="t,u,y", comments="")
    x = read_recording(tmp_path / "x.csv")
    assert x.sample_time == pytest.approx(np.polyfit(np.arange(1000), t - t[0], 1)[0], rel=1e-6)


def test_time_rounded_to_its_own_interval_is_not(tmp_path):
    t = np.round(1.6384e-3 * np.arange(1000), 3)
    table = np.column_stack([t, t, t])
    np.savetxt(tmp_path / "x.csv", table, "%.17g", ",", header="t,u,y", comments="")
    with pytest.raises(InputError, match="column t"):
        read_recording(tmp_path / "x.csv")


# Of the extras those that are installed: a skip within would pass over every format.
LIBRARIES = {".xlsx": "openpyxl", ".tdms": "nptdms", ".feather": "pyarrow"}
EXTRAS = [suffix for suffix, library in LIBRARIES.items() if find_spec(library)]


def _valid(tmp_path, suffix):
    y, u, t = np.arange(50.0), np.ones(50), 0.01 * np.arange(50)
    path = tmp_path / f"valid{suffix}"
    if suffix == ".csv":
        np.savetxt(path, np.column_stack([t, u, y]), "%.9g", ",", header="t,u,y", comments="")
    elif suffix == ".mat":
        scipy.io.savemat(path, {"t": t, "u": u, "y": y})
    elif suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["t"], file["u"], file["y"] = t, u, y
    elif suffix == ".npz":
        np.savez(path, t=t, u=u, y=y)
    elif suffix == ".lvm":
        head = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\nSamples\t50\t50\n"
        head += "***End_of_Header***\nX_Value\tu\ty\tComment"
        np.savetxt(path, np.column_stack([t, u, y]), "%.9g", "\t", header=head, comments="")
    elif suffix == ".wav":
        scipy.io.wavfile.write(path, 100, np.column_stack([u, y]).astype(np.int16))
        columns = '[columns]\nt = "t"\nu = "channel_1"\ny = "channel_2"\n'
        (tmp_path / "damaged.wav.map.toml").write_text(columns)
    elif suffix == ".xlsx":
        book = import_module("openpyxl").Workbook()
        for row in [("t", "u", "y"), *np.column_stack([t, u, y]).tolist()]:
            book.active.append(row)
        book.save(path)
    elif suffix == ".tdms":
        nptdms = import_module("nptdms")
        with nptdms.TdmsWriter(path) as file:
            pairs = (("t", t), ("u", u), ("y", y))
            file.write_segment([nptdms.ChannelObject("g", *pair) for pair in pairs])
    else:
        columns = import_module("pyarrow").table({"t": t, "u": u, "y": y})
        import_module("pyarrow.feather").write_feather(columns, path)
    return path


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    suffix=st.sampled_from([".csv", ".mat", ".h5", ".npz", ".lvm", ".wav", *EXTRAS]),
    where=st.floats(0, 1),
    junk=st.binary(max_size=20),
    cut=st.booleans(),
)
@example(suffix=".mat", where=0.1, junk=b"", cut=True)
@example(suffix=".csv", where=0.0, junk=b"\xff\xfe", cut=False)
def test_damaged_files_never_end_in_a_traceback(tmp_path, suffix, where, junk, cut):
    whole = _valid(tmp_path, suffix).read_bytes()
    at = int(where * len(whole))
    damaged = whole[:at] + junk + (b"" if cut else whole[at + len(junk) :])
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(damaged)
    try:
        x = read_recording(path)
    except InputError as error:
        said = str(error)
        x = None
    assert x is None or np.isfinite(x.y).all()
    assert x is not None or ("\n" not in said and said.startswith(str(path)))


@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(suffix=st.sampled_from(sorted(READERS)), content=st.binary(max_size=400))
def test_garbage_never_ends_in_a_traceback(tmp_path, suffix, content):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_recording(path)
    assert "\n" not in str(error.value)
