"""The score of a blind run on paper: confusion picture, calibration picture, section of the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffl.challenge import Score, markdown, score
from ffl.report.page import drawing
from ffl.systems.atomic import write_text


def confusion(ax: Axes, rows: Sequence[str], columns: Sequence[str], counts: np.ndarray) -> Axes:
    """Truth down, answer across; the shade is the share of the truth's row, the number the cases."""
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in np.argwhere(counts > 0):
        colour = "white" if share[i, j] > 0.6 else "black"
        ax.text(j, i, str(counts[i, j]), ha="center", va="center", color=colour, fontsize=8)
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=90)
    ax.set_yticks(range(len(rows)), [r.replace("_", " ") for r in rows])
    ax.set_xlabel("answered")
    ax.set_ylabel("true")
    ax.grid(False)
    return ax


def calibration(ax: Axes, bins: Sequence[tuple[float, float, float, int, float]]) -> Axes:
    """Stated confidence against the share that was right, with the number of names."""
    stated, right = [b[2] for b in bins], [b[4] for b in bins]
    ax.plot([0, 1], [0, 1], color="grey", linewidth=0.8)
    ax.plot(stated, right, "o-")
    for x, y, n in zip(stated, right, (b[3] for b in bins), strict=True):
        ax.annotate(f" {n}", (x, y), fontsize=8)
    ax.set_xlabel("stated confidence [-]")
    ax.set_ylabel("share that is right [-]")
    ax.set_xlim(0, 1.02)
    ax.set_ylim(0, 1.02)
    return ax


def score_with_report(
    cases: Path, answers: Path, truths: Path, out: Path, about: dict[str, str] | None = None
) -> Score:
    """Score a blind run; writes score.json, score.md, confusion.png and calibration.png in `out`.

    about: lines for the head of score.md (date, commit, command).
    """
    result = score(cases, answers, truths, out, about)
    with drawing():
        figure = Figure(figsize=(11, 8.5), layout="constrained")
        axes = figure.add_subplot()
        confusion(axes, result.confusion_rows, result.confusion_columns, result.confusion)
        figure.savefig(out / "confusion.png", dpi=110)
        figure = Figure(figsize=(4.5, 4), layout="constrained")
        calibration(figure.add_subplot(), result.calibration)
        figure.savefig(out / "calibration.png", dpi=110)
    return result


def append_section(result: Score, path: Path, about: dict[str, str]) -> None:
    """Add a blind run's section to the log of all of them, good or bad; nothing is replaced."""
    head = "# Blind challenge, run by run\n"
    before = path.read_text() if path.is_file() else head
    write_text(path, before.rstrip() + "\n\n" + markdown(result, about))
