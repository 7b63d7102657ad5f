"""Excel workbooks: where the table stands, dates, several sheets, and what is refused."""

from datetime import date, datetime, time, timedelta

import numpy as np
import pytest

from ffl.errors import InputError
from ffl.recordings import read_recording

openpyxl = pytest.importorskip("openpyxl")

N = 20
HEAD = ("t", "u", "y")
ROWS = [(0.01 * k, k + 0.5, k + 1.5) for k in range(N)]


def save(path, *sheets, **named):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in [(f"Tabelle{k + 1}", rows) for k, rows in enumerate(sheets)] + [
        *named.items()
    ]:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def edited(row, column, cell):
    rows = [list(cells) for cells in ROWS]
    rows[row][column] = cell
    return [HEAD, *rows]


@pytest.mark.parametrize(
    "rows",
    [
        [HEAD, *ROWS],
        [HEAD, ("[s]", "V", "mm"), *ROWS],
        [("t [s]", "u (V)", "y [mm]"), *ROWS],
        [("bench 3",), (), ("date", date(2024, 5, 6)), ("rate", 100), (), HEAD, *ROWS],
        [("Kp", "Ki", "Kd"), (1, 2, 3), (), HEAD, ("s", "V", "mm"), (), *ROWS],
        [(None, *HEAD), *[(None, *row) for row in ROWS]],
        [(*HEAD, "state", "", 7), *[(*row, "idle") for row in ROWS]],
        [HEAD, *[tuple(f"{x:.2f}" for x in row) for row in ROWS]],
        [HEAD, *[tuple(f"{x:.2f}".replace(".", ",") for x in row) for row in ROWS]],
        [HEAD, *ROWS, (), ("", " ")],
        [(*HEAD, "of the bench"), *[(*row, 1) for row in ROWS[:5]], *ROWS[5:]],
    ],
)
def test_where_the_table_stands(tmp_path, rows):
    x = read_recording(save(tmp_path / "x.xlsx", [("read me",)], rows))
    assert x.t == pytest.approx(0.01 * np.arange(N))
    assert np.array_equal(x.u, np.arange(N) + 0.5)
    assert np.array_equal(x.y, np.arange(N) + 1.5)
    if any("V" in str(cell) for row in rows for cell in row):
        assert dict(x.units) == {"t": "s", "u": "V", "y": "mm"}


@pytest.mark.parametrize(
    ("first", "start"),
    [
        (datetime(2024, 2, 28, 23, 59, 59, 990_000), 86399.99),
        ("28.02.2024 23:59:59,99", None),
        (timedelta(seconds=5), 5.0),
        (time(8, 0, 0, 10_000), 8 * 3600 + 0.01),
    ],
)
def test_dates_clock_times_and_durations_are_seconds(tmp_path, first, start):
    steps = [timedelta(milliseconds=10 * k) for k in range(N)]
    if isinstance(first, str):
        ticks = [f"28.02.2024 23:59:59,{10 * k:03d}" for k in range(N)]
        start = 86399.0
    elif isinstance(first, time):
        ticks = [(datetime.combine(date(2024, 1, 1), first) + step).time() for step in steps]
    else:
        ticks = [first + step for step in steps]
    path = save(
        tmp_path / "x.xlsx", [HEAD, *[(t, *row[1:]) for t, row in zip(ticks, ROWS, strict=True)]]
    )
    x = read_recording(path)
    assert x.t == pytest.approx(start + 0.01 * np.arange(N), abs=1e-6)
    assert x.sample_time == 0.01


def test_several_sheets(tmp_path):
    """A name that one sheet has stands for itself, one that two have needs its sheet."""
    path = save(tmp_path / "x.xlsx", fit=[HEAD, *ROWS], test=[("", "y", "d"), *ROWS])
    (tmp_path / "x.map.toml").write_text('[columns]\nt = "t"\nu = "fit.u"\ny = "fit.y"\nd = "d"\n')
    x = read_recording(path)
    assert np.array_equal(x.y, np.arange(N) + 1.5)
    assert np.array_equal(x.d, x.y)
    (tmp_path / "x.map.toml").unlink()
    with pytest.raises(InputError, match=r"no column y.*there is t, u, fit\.y, test\.y, d"):
        read_recording(path)
    bad = save(tmp_path / "y.xlsx", fit=[("bench",), HEAD, *ROWS], test=[("d",), (1.0,), ("off",)])
    columns = "\n".join(f'{c} = "{c}"' for c in "tuyd")
    (tmp_path / "y.map.toml").write_text(f"[columns]\n{columns}\n")
    with pytest.raises(InputError, match="sheet test, row 3, column d: 'off' is not a number"):
        read_recording(bad)


def test_of_a_formula_the_saved_value(tmp_path):
    """openpyxl saves none, as a program that never computed the sheet."""
    with pytest.raises(InputError, match="row 9, column y: there is no value"):
        read_recording(save(tmp_path / "x.xlsx", edited(7, 2, "=A9*2")))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "no sheet holds numbers below a row of names; write"),
        ([("only", "words"), ("and", "more")], "no sheet holds numbers below a row of names"),
        (ROWS, "no sheet holds numbers below a row of names"),
        ([HEAD], "no sheet holds numbers below a row of names"),
        ([HEAD, *ROWS[:5]], "5 samples are too few"),
        (edited(7, 2, None), "row 9, column y: there is no value"),
        (edited(7, 2, "off"), "row 9, column y: 'off' is not a number"),
        (edited(7, 2, "#DIV/0!"), "row 9, column y: '#DIV/0!' is not a number"),
        (edited(7, 2, "1,5"), "row 9, column y: '1,5' is not a number"),
        (edited(7, 2, datetime(2024, 5, 12)), "row 9, column y: '2024-05-12 00:00:00' is a date, not a"),
        (edited(7, 2, timedelta(seconds=5)), "row 9, column y: '5.0' is a duration, not a number"),
        ([HEAD, *ROWS, (), ("Kp", "Ki"), (1, 2)], "row 22, column t: there is no value"),
        (edited(7, 0, 0.06), "row 9, column t: time stands still"),
        (edited(N - 1, 2, None), r"unequal lengths \(t 20, u 20, y 19\)"),
        ([("t", "y", "y"), *ROWS], "'y' stands there 2 times"),
        ([("t", "y [m]", "y [mm]"), *ROWS], "'y' stands there 2 times"),
        ([HEAD, *[("NaN", *map(str, row[1:])) for row in ROWS]], "row 2, column t: nan is not a number"),
        ([HEAD, *[(f"08:00:{k:02d}" if k != 7 else "later", *r[1:]) for k, r in enumerate(ROWS)]],
         "row 9, column t: 'later' is not a time"),
        ([HEAD, *[(datetime(2024, 5, 6, 8, k) if k != 7 else 3, *r[1:]) for k, r in enumerate(ROWS)]],
         "row 2, column t: '2024-05-06 08:00:00' is a date, not a number"),
    ],
)  # fmt: skip
def test_refused_in_one_line(tmp_path, rows, said, refused):
    path = save(tmp_path / "x.xlsx", rows)
    refused(path, said)
