"""Every reader hands over the same recording; every spelling of CSV too."""

import sys
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.io.wavfile

from ffl.errors import InputError
from ffl.recordings import (
    READERS,
    load_mapping,
    read_recording,
    resample_recording,
    write_recording,
)
from ffl.recordings.stamps import seconds

REQUIRED = ("t", "r", "f", "u", "y")


def _csv(path, x):
    write_recording(x, path)


def _mat5(path, x):
    scipy.io.savemat(path, {"rec": {name: getattr(x, name) for name in REQUIRED}})


def _mat73(path, x):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in REQUIRED:  # MATLAB lays vectors out as rows
            file[f"rec/{name}"] = getattr(x, name)[None, :]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def _hdf5(path, x):
    with h5py.File(path, "w") as file:
        for name in REQUIRED:
            file[f"rec/{name}"] = getattr(x, name)
        file["rec/y"].attrs["unit"] = "m"


def _npz(path, x):
    np.savez(path, **{f"rec.{name}": getattr(x, name) for name in REQUIRED})


def _parquet(path, x):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    table = pyarrow.table({f"rec.{name}": getattr(x, name) for name in REQUIRED})
    parquet.write_table(table, path)


def _mdf(path, x):
    asammdf = pytest.importorskip("asammdf")
    signals = [
        asammdf.Signal(getattr(x, name), x.t, unit="m" if name == "y" else "", name=f"rec.{name}")
        for name in ("r", "f", "u", "y")
    ]
    with asammdf.MDF() as file:
        file.append(signals)
        file.save(path)


def _lvm(path, x):
    names = ("r", "f", "u", "y")
    lines = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t.", "X_Columns\tOne"]
    lines += ["***End_of_Header***", f"Samples{f'{chr(9)}{len(x)}' * 4}", "Y_Unit_Label\t\t\t\tm"]
    lines += [
        "***End_of_Header***",
        "\t".join(["X_Value", *(f"rec.{n}" for n in names), "Comment"]),
    ]
    table = np.column_stack([x.t, *(getattr(x, n) for n in names)])
    path.write_text("\n".join(lines + ["\t".join(map(repr, row)) for row in table.tolist()]))


def _xlsx(path, x):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append([f"rec.{n} [m]" if n == "y" else f"rec.{n}" for n in REQUIRED])
    for row in np.column_stack([getattr(x, n) for n in REQUIRED]).tolist():
        book.active.append(row)
    book.save(path)


def _tdms(path, x):
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_increment": x.sample_time, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(path) as file:
        for name in ("r", "f", "u", "y"):
            properties = clock | ({"unit_string": "m"} if name == "y" else {})
            channel = nptdms.ChannelObject("rec", name, getattr(x, name), properties=properties)
            file.write_segment([channel])


def _wav(path, x):
    samples = np.column_stack([getattr(x, name) for name in ("r", "f", "u", "y")])
    scipy.io.wavfile.write(path, round(1 / x.sample_time), samples)


def _arrow(path, x):
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table({f"rec.{name}": getattr(x, name) for name in REQUIRED})
    if path.suffix == ".feather":
        pytest.importorskip("pyarrow.feather").write_feather(table, path)
    else:
        with pyarrow.ipc.new_stream(path, table.schema) as stream:
            stream.write_table(table)


CLOCKS = (".mf4", ".lvm", ".tdms", ".wav")
"""Formats that state a sample time, from which `t` comes."""
UNITS = (".h5", ".mf4", ".lvm", ".tdms", ".xlsx")

WRITERS = {
    "x.csv": _csv,
    "a.mat": _mat5,
    "b.mat": _mat73,
    "x.h5": _hdf5,
    "x.npz": _npz,
    "x.parquet": _parquet,
    "x.feather": _arrow,
    "x.arrow": _arrow,
    "x.mf4": _mdf,
    "x.lvm": _lvm,
    "x.xlsx": _xlsx,
    "x.tdms": _tdms,
    "x.wav": _wav,
}


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".hdf5", ".csv"])
def test_names_as_a_file_has_them(tmp_path, recording, suffix):
    """Fields of a structured array, groups with slashes, a unit after a slash."""
    path, names = tmp_path / f"x{suffix}", {c: c for c in REQUIRED}
    kind = [(c, float) for c in REQUIRED]
    axis = np.array(list(zip(*(getattr(recording, c) for c in REQUIRED), strict=True)), kind)
    if suffix in (".npz", ".hdf5"):
        if suffix == ".npz":
            np.savez_compressed(path, axis=axis)
        else:
            with h5py.File(path, "w") as file:
                file["axis"] = axis
        names = {c: f"axis.{c}" for c in REQUIRED}
    elif suffix == ".h5":
        _hdf5(path, recording)
        names = {c: f"rec/{c}" for c in REQUIRED}
    else:
        head = "t / s;r / mm;f / N;u / N;y / mm"
        rows = np.column_stack([getattr(recording, c) for c in ("t", "r", "f", "u", "y")])
        np.savetxt(path, rows, "%.17g", ";", header=head, comments="")
    lines = [f'{c} = "{name}"' for c, name in names.items()]
    (tmp_path / "x.map.toml").write_text("\n".join(["[columns]", *lines]))
    read = read_recording(path)
    for column in REQUIRED:
        assert np.array_equal(getattr(read, column), getattr(recording, column))
    if suffix == ".csv":
        assert read_recording(path).units["y"] == "mm"


@pytest.mark.parametrize("name", WRITERS)
def test_same_bits_from_every_format(tmp_path, recording, same_bits, name):
    path = tmp_path / name
    WRITERS[name](path, recording)
    if path.suffix != ".csv":
        time = "t" if path.suffix in CLOCKS else "rec.t"
        own = {
            c: f"channel_{k}" if path.suffix == ".wav" else f"rec.{c}"
            for k, c in enumerate("rfuy", 1)
        }
        lines = [f'{c} = "{name}"' for c, name in own.items()]
        (tmp_path / f"{path.stem}.map.toml").write_text(
            "\n".join(["[columns]", f't = "{time}"', *lines])
        )
    read = read_recording(path)
    assert read.sample_time == 1e-3
    assert not read.missing
    for column in REQUIRED:
        one, other = getattr(read, column), getattr(recording, column)
        if path.suffix == ".xlsx":  # openpyxl writes 16 digits
            assert one == pytest.approx(other, rel=2e-16), column
        else:
            assert same_bits(one, other), column
    if path.suffix in UNITS:
        assert read.units["y"] == "m"


@pytest.mark.parametrize("name", ["x.csv", "x.mat", "x.h5", "x.npz"])
def test_a_second_encoder_comes_from_every_format_with_its_scale_and_unit(
    tmp_path, recording, name
):
    """Under its own name without a mapping, and scaled by one."""
    path = tmp_path / name
    columns = {c: getattr(recording, c) for c in REQUIRED} | {"y_load": 1e3 * recording.y}
    if name == "x.csv":
        write_recording(replace(recording, y_load=columns["y_load"]), path)
    elif name == "x.mat":
        scipy.io.savemat(path, columns)
    elif name == "x.npz":
        np.savez(path, **columns)
    else:
        with h5py.File(path, "w") as file:
            for column, values in columns.items():
                file[column] = values
    assert np.array_equal(read_recording(path).y_load, columns["y_load"])
    lines = [f'{c} = "{c}"' for c in REQUIRED]
    lines.append('y_load = { name = "y_load", scale = 1e-3, unit = "m" }')
    (tmp_path / "x.map.toml").write_text("\n".join(["[columns]", *lines]))
    read = read_recording(path)
    assert read.y_load == pytest.approx(recording.y, rel=1e-12)
    assert read.units["y_load"] == "m"
    assert len(read[10:30].y_load) == 20
    assert len(resample_recording(read, 2e-3).y_load) == len(resample_recording(read, 2e-3).y)


def test_every_suffix_has_a_test():
    assert {"." + name.split(".")[1] for name in WRITERS} == set(READERS) - {
        ".tsv",
        ".txt",
        ".dat",
        ".asc",
        ".hdf5",
        ".mdf",
        ".xlsm",
    }


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [
        (".parquet", "pyarrow", "parquet"),
        (".feather", "pyarrow", "parquet"),
        (".arrow", "pyarrow", "parquet"),
        (".mf4", "asammdf", "mdf"),
        (".tdms", "nptdms", "tdms"),
        (".xlsx", "openpyxl", "xlsx"),
    ],
)
def test_missing_extra_is_named(tmp_path, monkeypatch, suffix, module, extra):
    path = tmp_path / f"x{suffix}"
    path.write_bytes(b"anything")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"ffl\[{extra}\]"):
        read_recording(path)


BODY = "\n".join(f"{0.01 * k:.2f},{k % 3}.5,{k}.25" for k in range(30))


def _text(separator=",", end="\n", comma=False):
    text = "t,u,y\n" + BODY + "\n"
    if separator != ",":
        text = text.replace(",", separator)
    return (text.replace(".", ",") if comma else text).replace("\n", end)


@pytest.mark.parametrize(
    "content",
    [
        _text().encode(),
        _text().rstrip("\n").encode(),
        (_text() + "\n\n").encode(),
        _text(end="\r\n").encode(),
        _text(end="\r").encode(),
        _text(";").encode(),
        _text("\t").encode(),
        _text(" ").encode(),
        _text(";", comma=True).encode(),
        _text("\t", comma=True).encode(),
        _text(" ", comma=True).encode(),
        _text(";", comma=True).replace("0,00;0,5;0,25", "0;5e-1;25e-2").encode(),  # at rest first
        _text().encode("utf-8-sig"),
        _text().encode("utf-16"),
        _text().encode("utf-16-le"),
        _text().encode("utf-16-be"),
        _text().encode("utf-32"),
        ("# made by hand, µm\n% and on\n" + _text()).encode(),
        ("# made by hand, µm\n" + _text()).encode("latin-1"),
        ("# " + _text()).encode(),  # as numpy.savetxt writes a header
        ("# bench\n" + _text(" ").replace("t u y", "# t u y")).encode(),
        ("Prüfstand;A\nDatum;12.03.2024\n\n" + _text(";", comma=True)).encode("latin-1"),
        _text(";", "\r\n").replace("y\r\n", "y\r\ns;V;µm\r\n").encode("latin-1"),
        _text().replace("t,u,y", "bench,3,\nt,u,y\n[s],[V],[µm]").encode(),
        _text().replace("t,u,y", "t [s],u (V),y [µm]").encode("latin-1"),
        _text().replace("t,u,y", "t [s],u (V),y [µm]").encode(),
        _text().replace("t,u,y", '"t","u","y"').encode(),
        _text().replace("t,u,y", '"t","u","y",').replace("5\n", "5,\n").encode(),
        _text().replace("t,u,y\n", " t , u ,y \n").encode(),
        b'"t","u","y"\n'
        + b"\n".join(
            b",".join(b'"' + cell + b'"' for cell in line.split(b","))
            for line in BODY.encode().split(b"\n")
        ),
    ],
)
def test_spellings_of_csv(tmp_path, content):
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    x = read_recording(path)
    assert x.sample_time == 0.01
    assert np.array_equal(x.y, np.arange(30) + 0.25)
    assert np.array_equal(x.u, np.arange(30) % 3 + 0.5)
    if b"u (V)" in content or b";V;" in content or b"[V]" in content:
        assert dict(x.units) == {"t": "s", "u": "V", "y": "µm"}


@pytest.mark.parametrize(
    ("first", "others", "step"),
    [
        ("2024-02-28 23:59:50", ("2024-02-29 00:00:00", "2024-02-29T00:00:10Z"), 10.0),
        ("28.2.2024 23:59:50", ("29.2.2024 00:00:00", "29.02.2024 00:00:10"), 10.0),
        ("2/28/24 11:59:50 PM", ("2/29/24 12:00:00 AM", "2/29/24 12:00:10 AM"), 10.0),
        ("30/4/2024 23:59", ("1/5/2024 00:00", "1/5/2024 00:01"), 60.0),
        ("23:59:59,990", ("00:00:00,000", "00:00:00,010"), 0.01),
    ],
)
def test_dates_are_seconds(tmp_path, first, others, step):
    path = tmp_path / "log.dat"
    stamps = [first, *others]
    assert seconds(stamps) == pytest.approx(86400 - step + step * np.arange(3), abs=1e-6)
    assert seconds([*stamps, "later"]) == 3
    rows = [f"2024-05-06 08:{k:02d}:00;{k % 3};{k}" for k in range(20)]
    path.write_text("when;u;y [m]\n" + "\n".join(rows))
    (tmp_path / "log.map.toml").write_text('[columns]\nt = "when"\nu = "u"\ny = "y"\n')
    x = read_recording(path)
    assert (x.sample_time, x.t[0]) == (60.0, 8 * 3600.0)
    path.write_text("when;u;y [m]\n" + "\n".join([*rows[:7], "yesterday;1;2", *rows[8:]]))
    with pytest.raises(InputError, match="line 9, column when: 'yesterday' is not a time"):
        read_recording(path)


def test_header_from_the_mapping(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("a machine\nof 1999\n" + BODY)
    (tmp_path / "x.map.toml").write_text('header = ["t", "u", "y"]\nskip_lines = 2\n')
    assert len(read_recording(path)) == 30
    rules = load_mapping(tmp_path / "x.map.toml")
    scipy.io.savemat(tmp_path / "x.mat", {"y": np.arange(30.0)})
    with pytest.raises(InputError, match="for text files"):
        read_recording(tmp_path / "x.mat", rules)


def test_the_one_struct_that_holds_a_recording_needs_no_mapping(tmp_path):
    """As MATLAB users keep what they recorded: `save rec.mat rec`."""
    t, y = 0.01 * np.arange(60.0), np.sin(np.arange(60.0))
    rec = {"t": t, "u": 2.0 * y, "y": y, "who": "me"}
    scipy.io.savemat(tmp_path / "a.mat", {"rec": rec, "gain": 3.0})
    found = read_recording(tmp_path / "a.mat")
    np.testing.assert_array_equal(found.y, y)
    np.testing.assert_array_equal(found.u, 2.0 * y)
    assert found.sample_time == pytest.approx(0.01)
    scipy.io.savemat(tmp_path / "b.mat", {"rec": rec, "other": rec})
    with pytest.raises(InputError, match="no column y"):  # which of the two?
        read_recording(tmp_path / "b.mat")
    scipy.io.savemat(tmp_path / "c.mat", {"rec": {"y": y}, "sample_time": 0.01})
    with pytest.raises(InputError, match="no column y"):  # nor a recording
        read_recording(tmp_path / "c.mat")
    scipy.io.savemat(tmp_path / "d.mat", {"rec": rec, "t": t, "u": y, "y": 3.0 * y})
    np.testing.assert_array_equal(read_recording(tmp_path / "d.mat").y, 3.0 * y)


def test_columns_not_used_may_hold_anything(tmp_path):
    path = tmp_path / "x.csv"
    rows = "\n".join(f"{0.01 * k:.2f},n/a,1,{k}" for k in range(20))
    path.write_text("t,comment,u,y\n" + rows)
    x = read_recording(path)
    assert np.array_equal(x.y, np.arange(20.0))
    assert "columns not used: comment" in x.notes
