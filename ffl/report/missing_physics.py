"""reports/missing_physics.md: linear learning stalls, the physics is found, learning goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl.campaign.missing_physics import SETTLED, Story, last
from ffl.report.page import COLOURS, drawing, subplots

GREY, INK = "#b8c0c8", "#1b1f24"


def error_norms(stories: Sequence[Story], ax: Any, words: str = "diagnosed, calibrated") -> Any:
    """Error norm over the trials of every machine: the stall, the diagnosis, the drop; median bold."""
    before, after = len(stories[0].linear), len(stories[0].after)
    first = np.arange(1, before + 1)
    second = np.arange(before + 1, before + after + 1)
    for s in stories:
        ax.semilogy(first, s.linear, color=GREY, lw=0.8)
        ax.semilogy(second, s.after, color=GREY, lw=0.8)
    for x, key, promise, colour, label in (
        (first, "linear", "linear_promised", COLOURS[1], "linear model"),
        (second, "after", "promised", COLOURS[0], "with the physics found"),
    ):
        machine = np.median([getattr(s, key) for s in stories], axis=0)
        promised = np.median([getattr(s, promise) for s in stories], axis=0)
        ax.semilogy(x, machine, color=colour, lw=2.2, label=f"{label}: machine")
        ax.semilogy(x, promised, "--", color=colour, lw=1.6, label=f"{label}: promise")
    stall = float(np.median([s.stall for s in stories]))
    low = min(min(s.after) for s in stories)
    ax.axvline(before + 0.5, color=INK, lw=0.8, ls=":")
    ax.annotate("the stall", (before, 0.4 * stall), color=COLOURS[1], ha="right")
    ax.annotate(words, (before + 0.65, 1.5), rotation=0, color=INK, va="center")
    ax.annotate(
        "", (before + 0.8, 1.3 * low), (before + 0.8, stall), arrowprops={"arrowstyle": "->"}
    )
    drop = 100 * float(np.median([s.drop for s in stories]))
    ax.annotate(f"{drop:.0f} % less", (before + 1.0, 0.2 * stall), color=INK)
    ax.set(xlabel="trial", ylabel="2-norm of the error (m)", xlim=(1, before + after))
    ax.legend(loc="center right")
    return ax


def sizes(story: Story) -> str:
    friction, cogging, cable = (e.parameters for e in story.true)
    return f"{friction['level']:.1f} | {cogging['amplitude']:.1f} | {cable['stiffness']:.1f}"


def summary(stories: Sequence[Story]) -> str:
    """How many machines meet each of the bars, and the medians."""
    n = len(stories)
    drops = np.array([s.drop for s in stories])
    carried = np.array([s.extrapolation for s in stories])
    gaps = np.array([s.promise_gap for s in stories])
    points = np.array([reduction_gap(s) for s in stories])
    rows = [
        ("drop below the stall >= 60 %", drops >= 0.6, drops),
        ("extrapolation improved by >= 50 %", carried >= 0.5, carried),
        ("error norm within 10 % of the promised", np.abs(gaps) <= 0.1, gaps),
        ("reduction from trial 1 within 1 point of the promised", np.abs(points) <= 0.01, points),
    ]
    exact = sum(exactly_named(s) for s in stories)
    lines = [
        "| bar | machines | median | worst |",
        "|---|---|---|---|",
        f"| named: the effects drawn and no other | {exact} of {n} | | |",
    ]
    for title, met, values in rows:
        worst = values[np.argmax(np.abs(values))] if "promised" in title else values.min()
        lines.append(
            f"| {title} | {int(met.sum())} of {n} | {100 * np.median(values):.1f} % "
            f"| {100 * worst:.1f} % |"
        )
    return "\n".join(lines)


def reduction_gap(story: Story) -> float:
    """Promised less reached reduction of the first trial's error: the measure of the printer paper's
    45 % and 23 %."""
    return (last(story.after, SETTLED) - last(story.promised, SETTLED)) / story.linear[0]


def exactly_named(story: Story) -> bool:
    return sorted(e.name for e in story.found) == sorted(e.name for e in story.true)


def named(stories: Sequence[Story]) -> str:
    """What the diagnosis of every machine says beside what was drawn."""
    lines = ["| machine | named | number: found (drawn) |", "|---|---|---|"]
    for s in stories:
        drawn = {e.name: e.parameters for e in s.true}
        numbers = []
        for e in s.found:
            true = drawn.get(e.name, {})
            for key, value in e.parameters.items():
                beside = f" ({true[key]:.4g})" if key in true else ""
                numbers.append(f"{key} {value:.4g}{beside}")
        names = " + ".join(e.name for e in s.found) or "nothing"
        lines.append(f"| {s.seed} | {names} | {', '.join(numbers)} |")
    return "\n".join(lines)


def table(stories: Sequence[Story]) -> str:
    """One row a machine."""
    lines = [
        "| machine | Coulomb (N) | cogging (N) | cable (N/m) | linear promise | stall | after | drop "
        "| promised | machine/promise - 1 | second reference: stalled, after, promised |",
        "|" + "---|" * 11,
    ]
    for s in stories:
        after, promised = last(s.after, SETTLED), last(s.promised, SETTLED)
        lines.append(
            f"| {s.seed} | {sizes(s)} | {last(s.linear_promised):.4f} | {s.stall:.3f} | {after:.4f} "
            f"| {100 * s.drop:.1f} % | {promised:.4f} "
            f"| {100 * s.promise_gap:+.0f} ± {100 * s.promise_doubt:.0f} % "
            f"| {s.linear_second:.3f}, {s.second:.4f}, {s.second_promised:.4f} |"
        )
    return "\n".join(lines)


def write(stories: Sequence[Story], folder: Path, before: str, after: str) -> None:
    """missing_physics.md and its picture in `folder`; `before` and `after` are the words around."""
    folder.mkdir(parents=True, exist_ok=True)
    with drawing():
        figure, ax = subplots(8.6, 4.6)
        error_norms(stories, ax)
        figure.savefig(folder / "missing_physics.png", dpi=130)
    picture = "![Error norm over the trials](missing_physics.png)"
    parts = [before, picture, summary(stories), named(stories), table(stories), after]
    (folder / "missing_physics.md").write_text("\n\n".join(p for p in parts if p) + "\n")
