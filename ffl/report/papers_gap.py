"""reports/papers_gap.md: which left-out physics turns the promise into what was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ffl.campaign.papers_gap import KINDS, MEASURED, TOGETHER, PapersGap
from ffl.report.page import COLOURS, Page, drawing, subplots

TITLES = ("OBF below FIR (W_e = 50)", "repeated OBF below OBF (W_e = 1e5)")
LEAST = -1.0  # reductions below this are drawn at it: learning has diverged


def reductions(gap: PapersGap, ax: Any, index: int) -> Any:
    """One row a case: every machine drawn, median, 5 to 95 %; the paper's measured number."""
    cases = list(TOGETHER)
    for row, case in enumerate(cases):
        values = np.clip(gap.reductions(case)[:, index], LEAST, 1.0)
        low, middle, high = np.percentile(values, [5, 50, 95])
        ax.plot(values, np.full(len(values), row), ".", color="#b8c0c8", ms=4)
        ax.plot([low, high], [row, row], color=COLOURS[0], lw=1.6)
        ax.plot(middle, row, "o", color=COLOURS[0], ms=6)
    measured = list(MEASURED.values())[index]
    ax.axvline(measured, color=COLOURS[1], ls="--", lw=1.6)
    ax.annotate(f"measured {measured:.0%} ", (measured, -0.75), color=COLOURS[1], ha="right")
    ax.set(
        yticks=range(len(cases)),
        yticklabels=[c.replace("_", ", ") for c in cases],
        xlabel="share of the error taken away",
        title=TITLES[index],
        xlim=(LEAST - 0.05, 1.05),
        ylim=(len(cases) - 0.5, -1.1),
    )
    return ax


def by_size(gap: PapersGap, ax: Any, kind: str) -> Any:
    """Both reductions over the size of one kind of physics, drawn alone."""
    sizes, values = gap.sizes[kind][:, 0], np.clip(gap.reductions(kind), LEAST, 1.0)
    order = np.argsort(sizes)
    for k, (key, measured) in enumerate(MEASURED.items()):
        ax.plot(
            sizes[order], values[order, k], "os"[k] + "-", ms=4, lw=0.8, color=COLOURS[k], label=key
        )
        ax.axhline(measured, color=COLOURS[k], ls="--", lw=1.2)
    ax.set(xlabel=f"{KINDS[kind].what} ({KINDS[kind].unit})", ylabel="share taken away")
    if KINDS[kind].logarithmic:
        ax.set_xscale("log")
        ax.xaxis.set_minor_formatter("")
    return ax


def table(gap: PapersGap) -> list[list[str]]:
    """Case, ranges, both reductions (median, 5 to 95 %), machines with both below their promise."""
    out = []
    for case, kinds in TOGETHER.items():
        values = gap.reductions(case)
        sizes = "; ".join(
            f"{KINDS[k].what} {KINDS[k].low:g} to {KINDS[k].high:g} {KINDS[k].unit}" for k in kinds
        )
        cells = []
        for k in range(2):
            low, middle, high = 100 * np.percentile(values[:, k], [5, 50, 95])
            measured = 100 * list(MEASURED.values())[k]
            inside = "yes" if low <= measured <= high else "no"
            cells += [f"{middle:.0f} % ({low:.0f} to {high:.0f})", inside]
        fir, obf, strong, repeated = np.median(gap.norms[case], axis=0)
        norms = f"{fir:.3g}, {obf:.3g}, {strong:.3g}, {repeated:.3g}"
        what = sizes if case != "all" else "all seven"
        out.append([case.replace("_", ", "), what, *cells, norms])
    return out


HEADER = [
    "left out", "size, drawn uniformly (logarithmically over a decade or more)", "OBF below FIR",
    "45 % within", "repetition below OBF", "23 % within", "median e_10: FIR, OBF, OBF 1e5, repeated (m)",
]  # fmt: skip


def figures(gap: PapersGap) -> tuple[Any, Any]:
    """The reductions case by case, and over the size of friction and of the wandering force."""
    with drawing():
        first, axes = subplots(10.0, 4.8, 1, 2, sharey=True)
        for index, ax in enumerate(axes):
            reductions(gap, ax, index)
        second, axes = subplots(10.0, 3.2, 1, 2, sharey=True)
        for ax, kind in zip(axes, ("friction", "wandering"), strict=True):
            by_size(gap, ax, kind)
        axes[0].legend(loc="lower left", title="dashed: measured")
    return first, second


def page(gap: PapersGap) -> Page:
    """Everything measured, as one self-contained page."""
    made = Page(
        "The printer paper's own gap",
        "Which physics that a linear simulation leaves out turns 95 % into 45 %, and repetition's gain "
        "into 23 %.",
    )
    first, second = figures(gap)
    made.section("Case by case").figure(
        first, "Reductions", "Grey: machines; blue: median, 5 to 95 %."
    )
    made.table(HEADER, table(gap), "Every machine is drawn; none is tuned.")
    made.section("Over the size").figure(second, "Reductions over the size", "Dashed: measured.")
    return made


def write(gap: PapersGap, folder: Path, before: str, after: str) -> None:
    """papers_gap.md and its pictures in `folder`; `before` and `after` are the words around."""
    folder.mkdir(parents=True, exist_ok=True)
    for figure, name in zip(figures(gap), ("papers_gap", "papers_gap_sizes"), strict=True):
        with drawing():
            figure.savefig(folder / f"{name}.png", dpi=120)
    lines = ["| " + " | ".join(HEADER) + " |", "|" + "---|" * len(HEADER)]
    lines += ["| " + " | ".join(row) + " |" for row in table(gap)]
    pictures = (
        "![Reductions case by case](papers_gap.png)",
        "![Over the size](papers_gap_sizes.png)",
    )
    parts = [before, pictures[0], "\n".join(lines), pictures[1], after]
    (folder / "papers_gap.md").write_text("\n\n".join(p for p in parts if p) + "\n")
