"""The two encoders of a transmission in a report: sentences, numbers, one picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from ffl.diagnose.transmission.result import Drawn, Transmission
from ffl.report.page import COLOURS, Page, number, subplots


def print_transmission(answer: Mapping[str, Any]) -> None:
    """The key `transmission` of answer.json in a few lines."""
    rms = answer["difference_rms"]
    print(
        f"  between the encoders: {rms['value']:.3g} {rms['unit']} RMS, below {answer['below_hz']:.3g} Hz; "
        f"{100 * answer['explained_held_out']:.4g} % explained in {answer['judged_by']}"
    )
    for term in answer["terms"]:
        print(f"    {term['name']}: {term['says']}")
        figures = [
            f"{key} {f['value']:.5g}"
            + (f" ± {f['std_error']:.2g}" if f.get("std_error") else "")
            + (f" {f['unit']}" if f["unit"] != "1" else "")
            for key, f in term["parameters"].items()
        ]
        print(f"      {', '.join(figures)}")
        if term["alternatives"]:
            print(f"      as well explained by {', '.join(term['alternatives'])}")
    if not answer["terms"]:
        print(
            "    nothing but noise: the transmission is stiff and without play as far as this shows"
        )
    if "stiffness_95" in answer:
        s = answer["stiffness_95"]
        above = f" to {s['at_most']:.3g}" if "at_most" in s else " or more"
        print(f"    stiffness, 95 %: {s['at_least']:.3g}{above} {s['unit']}")
    for line in answer["cannot_tell"]:
        print(f"    cannot tell: {line}")
    for line in answer.get("notes", ()):
        print(f"    note: {line}")


def transmission_section(page: Page, t: Transmission) -> None:
    """What the second encoder tells."""
    page.section("Between motor and load")
    for part in t.parts:
        page.note(f"{part.name}: {part.says}", "good")
    for line in t.undecided:
        page.note(f"Cannot tell. {line}")
    rows = [
        [part.name, key, f.value, f.unit, f.std_error]
        for part in t.parts
        for key, f in part.parameters.items()
    ]
    if rows:
        page.table(["term", "number", "value", "unit", "standard error"], rows)
    page.text(
        f"Difference y - y_load: {number(t.difference)} {t.unit} RMS below {number(t.cut)} Hz, "
        f"{number(t.left)} left. Explained in {t.judged}: {100 * t.explained:.4g} % of its power, by the "
        f"delay alone {100 * t.explained_by_delay:.4g} %."
    )
    shown = t.drawn[0]
    figure, axes = subplots(rows=2, columns=1, height=5.6)
    over_time(axes[0], shown, t.unit)
    over_torque(axes[1], shown, t.unit, t.force)
    page.figure(
        figure, "The two encoders",
        "Above: the difference over time, what the terms named explain of it, and what is left. Below: "
        "what all terms but the spring leave, against the torque transmitted; a spring is "
        "a straight line.",
    )  # fmt: skip
    for note in t.notes:
        page.note(note)


def over_time(ax: Axes, d: Drawn, unit: str) -> Axes:
    """Difference, explained, left."""
    ax.plot(d.t, d.difference, color=COLOURS[6], linewidth=1.0, label="motor - load")
    ax.plot(d.t, d.explained, "--", color=COLOURS[1], label="explained")
    ax.plot(d.t, d.rest, color=COLOURS[0], linewidth=0.9, label="left")
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"difference [{unit}]")
    ax.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))  # above: curves fill the axes
    return ax


def over_torque(ax: Axes, d: Drawn, unit: str, force: str) -> Axes:
    """What goes with the torque, over it."""
    if d.torque is None:
        ax.plot(d.t, d.rest, color=COLOURS[0])
        ax.set_xlabel("time [s]")
        ax.set_ylabel(f"left [{unit}]")
        return ax
    spring = 0.0 if d.torsion is None else d.torsion
    ax.plot(
        d.torque,
        d.rest + spring,
        ".",
        markersize=3,
        color=COLOURS[5],
        label="left beside the spring",
    )
    if d.torsion is not None:
        ax.plot(d.torque, spring, ".", markersize=2, color=COLOURS[1], label="spring")
        ax.legend(markerscale=3)
    ax.set_xlabel(f"transmitted, from {d.by} [{force}]")
    ax.set_ylabel(f"difference [{unit}]")
    return ax
