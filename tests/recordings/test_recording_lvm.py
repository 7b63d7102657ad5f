"""LabVIEW measurement files: each way x is saved, segments, and what is refused."""

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.recordings import read_recording

N = 20
CLOCK = "09:51:40,{:06d}"


def head(x="One", separator="\t", decimal="."):
    tags = [
        ("Writer_Version", "2"),
        ("Separator", "Tab" if separator == "\t" else "Comma"),
        ("Decimal_Separator", decimal),
        ("Multi_Headings", "Yes"),
        ("X_Columns", x),
        ("Date", "2024/05/06"),
        ("Time", CLOCK.format(0)),
    ]
    lines = ["LabVIEW Measurement", *tags, "***End_of_Header***", ""]
    return "\n".join(s if isinstance(s, str) else separator.join(s) for s in lines) + "\n"


def segment(
    x="One", names=("u", "y"), units=("V", "mm"), n=N, micro=0, step=0.01, first=0.0, x0=0.0
):
    """A segment whose channel c is c.5, c.5 + 1, ...; written with points, tabs and a comment."""
    multi = x == "Multi"

    def spread(cells):
        return "\t".join(f"{c}\t" for c in cells) if multi else "\t".join(cells)

    each = len(names)
    lines = [
        f"Channels\t{each}",
        "Samples\t" + spread([str(n)] * each),
        "Date\t" + spread(["2024/05/06"] * each),
        "Time\t" + spread([CLOCK.format(micro)] * each),
        "Y_Unit_Label\t" + spread(units),
        "X_Dimension\t" + spread(["Time"] * each),
        "X0\t" + spread([f"{x0:.16E}"] * each),
        f"Delta_X\t{spread([f'{step:.6f}'] * each)}",
        "***End_of_Header***\t",
        ("\t".join(f"X_Value\t{n}" for n in names) if multi else "\t".join(("X_Value", *names)))
        + "\tComment",
    ]
    for k in range(n):
        time = "" if x == "No" else f"{first + k * step:.6f}"
        values = [f"{c + 0.5 + k:.6f}" for c in range(each)]
        cells = [c for v in values for c in (time, v)] if multi else [time, *values]
        lines.append("\t".join(cells + ["start, so to say"] * (k == 0)))
    return "\n".join(lines) + "\n\n"


def with_commas(text):
    """As LabVIEW writes where the decimal separator is a comma."""
    return text.replace(".", ",").replace("so to say", "")


def saved(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def is_the_recording(x, n=N):
    assert x.t == pytest.approx(0.01 * np.arange(n), abs=1e-9)
    assert x.sample_time == 0.01
    assert np.array_equal(x.u, np.tile(np.arange(N) + 0.5, n // N))
    assert np.array_equal(x.y, np.tile(np.arange(N) + 1.5, n // N))
    assert dict(x.units) == {"t": "s", "u": "V", "y": "mm"}
    return True


@pytest.mark.parametrize("x", ["One", "Multi", "No"])
@pytest.mark.parametrize("spelling", ["points", "commas", "comma separated", "undeclared commas"])
def test_every_spelling_of_the_same_samples(tmp_path, x, spelling):
    text = head(x) + segment(x)
    if spelling == "comma separated":
        text = head(x, ",") + segment(x).replace(", so", " so").replace("\t", ",")
    elif "commas" in spelling:
        text = head(x, decimal=",") + with_commas(segment(x))
        if spelling == "undeclared commas":
            text = text.replace("Decimal_Separator\t,\n", "")
    assert is_the_recording(read_recording(saved(tmp_path / "x.lvm", text)))


def test_a_byte_order_mark_line_ends_and_special_blocks_say_nothing(tmp_path):
    special = "***Start_Special***\nChannels\t9\n7\t7\t7\n***End_Special***\n"
    text = head() + special + segment().rstrip("\n") + "\n" + special
    path = tmp_path / "x.lvm"
    path.write_bytes(text.replace("\n", "\r\n").encode("utf-8-sig"))
    assert is_the_recording(read_recording(path))


@pytest.mark.parametrize("x", ["One", "No"])
def test_segments_that_follow_one_another_are_one_recording(tmp_path, x):
    """By the time of day of their headers where x begins anew, or by x itself."""
    anew = head(x) + segment(x) + segment(x, micro=200_000)
    assert is_the_recording(read_recording(saved(tmp_path / "a.lvm", anew)), 2 * N)
    on = head(x) + segment(x) + segment(x, first=0.2, x0=0.2)
    read = read_recording(saved(tmp_path / "b.lvm", on))
    assert is_the_recording(read, 2 * N)


def test_segments_with_a_pause_between_them_are_not(tmp_path):
    path = saved(tmp_path / "x.lvm", head() + segment() + segment(micro=300_000))
    with pytest.raises(InputError, match=r"no column y.*segment_1\.u, segment_1\.y, segment_1\.t"):
        read_recording(path)
    columns = ", ".join(f'{c} = "segment_2.{c}"' for c in ("t", "u", "y"))
    (tmp_path / "x.map.toml").write_text(
        f'[[recordings]]\nname = "second"\ncolumns = {{ {columns} }}\n'
    )
    assert is_the_recording(read_recording(f"{path}::second"))


def test_x_under_its_own_name_and_a_channel_that_is_called_t(tmp_path):
    path = saved(tmp_path / "x.lvm", head() + segment(names=("u", "y", "pos"), units=("", "", "m")))
    (tmp_path / "x.map.toml").write_text('[columns]\nt = "X_Value"\nu = "u"\ny = "pos"\n')
    assert read_recording(path).sample_time == 0.01
    (tmp_path / "x.map.toml").unlink()
    assert "columns not used: pos" in read_recording(path).notes
    path = saved(tmp_path / "x.lvm", head("No") + segment("No", names=("t", "y", "u")))
    assert read_recording(path).t[0] == 0.5


def test_a_sample_time_of_the_mapping_needs_no_x(tmp_path):
    path = saved(tmp_path / "x.lvm", head("No") + segment("No"))
    (tmp_path / "x.map.toml").write_text('sample_time = 0.5\n[columns]\nu = "u"\ny = "y"\n')
    assert read_recording(path).sample_time == 0.5
    saved(tmp_path / "y.lvm", path.read_text())
    with pytest.raises(InputError, match=r"sample time is 0\.01 s, not 0\.5 s"):
        read_recording(tmp_path / "y.lvm", sample_time=0.5)


def test_without_a_labview_header_it_is_text(tmp_path):
    rows = "\n".join(f"{0.01 * k:.2f}\t{k}.5\t{k + 1}.5" for k in range(N))
    path = saved(tmp_path / "x.lvm", rows)
    with pytest.raises(InputError, match=r"line 1 holds numbers.*give header"):
        read_recording(path)
    mapping = tmp_path / "x.map.toml"
    mapping.write_text('header = ["t", "u", "y"]\n')
    assert np.array_equal(read_recording(path).y, np.arange(N) + 1.5)
    saved(path, head() + segment())
    with pytest.raises(InputError, match="LabVIEW's own header; leave header"):
        read_recording(path)


WHOLE = head() + segment()
ROW = "0.070000\t7.500000\t8.500000\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (head(), r"no segment of samples below the header \(line 9\)"),
        (head()[:100], "cut off in the header"),
        (WHOLE[: WHOLE.index("X_Value")], "cut off in the header, before the names"),
        (WHOLE[: WHOLE.index("0.000000\t")], "no sample below the names of line 20"),
        (WHOLE + "Channels\t2\nSamples\t20\t20\n", r"cut off in the header of a segment \(line 42\)"),
        (WHOLE[: WHOLE.index(ROW) + 12], "line 28 has 2 columns, the line before 3; the file is cut off"),
        (WHOLE[: WHOLE.index(ROW)], "'.' has 7 samples from line 21 on, its header says 20"),
        (WHOLE.replace(ROW, "0.070000\t7.5\t\n"), "line 28, column y: there is no value"),
        (WHOLE.replace(ROW, "0.070000\t7.5\toff\n"), "line 28, column y: 'off' is not a number"),
        (WHOLE.replace(ROW, "0.070000\t7.5\tNaN\n"), "line 28, column y: nan is not a number"),
        (WHOLE.replace(ROW, "0.060000\t7.5\t8.5\n"), "line 28, column t: time stands still"),
        (WHOLE.replace("\tu\ty\t", "\ty\ty\t"), "'y' stands there 2 times"),
        (WHOLE.replace("0.010000\t0.010000\n", "0.010000\t0.020000\n", 1), "sampled on different clocks"),
        (WHOLE.replace("\tTime\tTime", "\tFrequency\tFrequency"), "no time column t"),
        (head("No") + segment("No", step=0.0), "no time column t"),
        (head("Multi") + segment("Multi").replace("0.080000\t9.5", "0.080500\t9.5"), "different clocks"),
    ],
)  # fmt: skip
def test_refused_in_one_line(tmp_path, text, said, refused):
    path = saved(tmp_path / "x.lvm", text)
    refused(path, said)


def test_a_channel_with_fewer_samples_is_of_another_length(tmp_path):
    """Its cells are empty at the end; they are not taken for samples."""
    rows = segment().replace("Samples\t20\t20", "Samples\t20\t15").split("\n")
    first = next(k for k, row in enumerate(rows) if row.startswith("0.150000"))
    cut = [row.rsplit("\t", 1)[0] + "\t" for row in rows[first : first + 5]]
    path = saved(tmp_path / "x.lvm", head() + "\n".join(rows[:first] + cut))
    with pytest.raises(InputError, match=r"unequal lengths \(t 20, u 20, y 15\)"):
        read_recording(path)
