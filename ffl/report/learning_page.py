"""The report of a learning campaign: figures, table, and what each shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.report import learning_figures as draw
from ffl.report.finished import (
    FinishedRun,
    cumulative_power,
    motion_interval,
    pre_actuation,
    same_reference,
)
from ffl.report.page import Page, drawing, subplots
from ffl.report.weight_words import equal_error_weights
from ffl.systems import Plant, StateSpace, Zpk, as_zpk
from ffl.systems.state_space import Array

PAPER = "the 2018 printer paper"
IN_A_ROW = 4  # runs of a legend that stand beside one another within the figure's width
AT_ONE = 1e-6  # distance of a zero from 1 that rounding alone makes


def learning_page(runs: Sequence[FinishedRun]) -> Page:
    """One page from the runs of one or more folders; signals are compared where the reference is
    the same."""
    campaigns = {run.folder: run.campaign for run in runs}
    names = ", ".join(dict.fromkeys(c.name for c in campaigns.values()))
    first = runs[0].campaign
    page = Page(
        f"Learning campaign: {names}",
        f"{len(runs)} runs on {_list([c.machine.name for c in campaigns.values()])}, learned with "
        f"the model {_list([c.model.name for c in campaigns.values()])}; "
        f"{len(first.reference)} samples of {first.sample_time * 1e3:g} ms.",
    )
    _summary(page, runs)
    _errors(page, runs)
    for index, folder in enumerate(campaigns):
        group = [run for run in runs if run.folder == folder]
        if index == 0 or not same_reference(group[0], runs[0]):
            same = [run for run in runs if same_reference(run, group[0])]
            _time_domain(page, same)
        model = _text(group[0], "model")
        if index == 0 or model != _text(runs[0], "model"):
            _plant(page, [run for run in runs if _text(run, "model") == model])
    _power(page, runs)
    _parameters(page, runs)
    _second(page, runs)
    _how(page, runs)
    return page


def _list(names: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _text(run: FinishedRun, plant: str) -> str:
    """The plant file as resolved: equal texts are equal plants."""
    return run.campaign.resolved[f"{plant}.toml"]


def _label(unit: str) -> str:
    return unit or "-"


def _summary(page: Page, runs: Sequence[FinishedRun]) -> None:
    page.section("Runs compared")
    best = min(runs, key=lambda run: run.error_norm[-1])
    unit = best.campaign.machine.output_unit
    page.facts(
        [
            ("trials", max(run.trials for run in runs)),
            (f"feedback only, ‖e₁‖ [{_label(unit)}]", best.error_norm[0]),
            (f"best last trial, {best.label} [{_label(unit)}]", best.error_norm[-1]),
            ("of its first error", f"{best.error_norm[-1] / best.error_norm[0]:.2%}"),
        ]
    )
    rows = []
    for run in runs:
        updates = run.entry["update"]
        residuals = [u["kkt_residual"] for u in updates if "kkt_residual" in u]
        norms = run.error_norm
        rows.append(
            [
                run.label,
                run.entry["status"],
                run.entry["parameters"],
                norms[0],
                norms[-1],
                norms[-1] / norms[0],
                run.entry["feedforward_norm"][-1],
                float(np.median([u["seconds"] for u in updates])) if updates else None,
                max(residuals) if residuals else None,
                _used(run),
                max((u.get("active", 0) for u in updates), default=0),
            ]
        )
    header = [
        "run", "status", "parameters", f"‖e₁‖ [{_label(unit)}]", f"‖e_last‖ [{_label(unit)}]",
        "last / first", "‖f_last‖", "update [s]", "KKT residual", "directions used", "active bounds",
    ]  # fmt: skip
    page.table(
        header,
        rows,
        "2-norms over all samples of the reference, the rest before and after the motion included. "
        "Update: median wall time. KKT residual: the largest of all updates, relative; below 1e-8 "
        "the update is the minimiser of criterion (3) over the directions used. Where these are "
        "fewer than the parameters, the reference shows the others less than 1e-10 of the largest; "
        "they are left at zero, since with them parameters grow large and cancel, and in brackets "
        "stands by how much at most criterion (3) therefore lies above its minimum over all.",
    )
    if len(runs) > 1:
        page.heading("Last error of each run, below that of another")
        rows = [[a.label, *(_below(a, b) if a is not b else "" for b in runs)] for a in runs]
        page.table(
            ["‖e_last‖ of … is below that of", *(run.label for run in runs)],
            rows,
            "1 − ‖e_last‖ of the row / ‖e_last‖ of the column; negative: larger, from twice on as a ratio."
            + (
                " The paper's real printer gave 45 % for OBF below FIR (W_e = 50) and 23 % for "
                "repeated poles below once (W_e = 1e5); a linear simulation leaves out what limits "
                "the real machine."
                if best.campaign.model.name == "flatbed_printer"
                else ""
            ),
        )
    for run in runs:
        if "message" in run.entry:
            page.note(f"{run.label} stopped ({run.entry['status']}): {run.entry['message']}", "bad")


def _used(run: FinishedRun) -> str:
    """Rank of the updates' problems of the number of parameters, and what the others would bring."""
    updates = run.entry["update"]
    if not updates:
        return ""
    ranks = sorted({u["rank"] for u in updates if "rank" in u})
    if not ranks:
        return ""
    told = f"{ranks[0]}" if len(ranks) == 1 else f"{ranks[0]} to {ranks[-1]}"
    left = max((u["left_out"] for u in updates if "left_out" in u), default=0.0)
    beside = f" ({left:.2%})" if ranks[0] < run.entry["parameters"] and left else ""
    return f"{told} of {run.entry['parameters']}{beside}"


def _below(one: FinishedRun, other: FinishedRun) -> str:
    """By how much the one's last error is below the other's, in per cent; of a larger one the ratio."""
    ratio = one.error_norm[-1] / other.error_norm[-1]
    return f"{1 - ratio:+.1%}" if ratio < 2 else f"{ratio:.3g} times as large"


def _errors(page: Page, runs: Sequence[FinishedRun]) -> None:
    unit = _label(runs[0].campaign.machine.output_unit)
    with drawing():
        figure, ax = subplots(8.6, 3.8)
        draw.error_per_trial(ax, [(run.label, np.array(run.error_norm)) for run in runs], unit)
        page.section("Error over the trials").figure(
            figure,
            "Error norm of every trial",
            "Trial 1 runs on feedback alone (θ = 0); each further one uses what was learned from "
            "the trial before. A curve that has become level has converged: what is left the "
            "parametrization cannot remove, the weights on f or a bound keep, or it does not repeat. "
            f"Counterpart of Figure 7 of {PAPER}.",
        )


def _time_domain(page: Page, runs: Sequence[FinishedRun]) -> None:
    campaign = runs[0].campaign
    time, reference = campaign.time, campaign.reference
    start, end = motion_interval(reference, campaign.sample_time)
    unit_y, unit_f = _label(campaign.machine.output_unit), _label(campaign.machine.input_unit)
    errors = [(run.label, run.signal("e")) for run in runs]
    forwards = [(run.label, run.signal("f")) for run in runs]
    first = round(start / campaign.sample_time)
    early = {run.label: pre_actuation(f, first) for run, (_, f) in zip(runs, forwards, strict=True)}
    longest = max(*early.values(), 20)
    before = min(first, round(1.25 * longest))
    zoom = slice(first - before, min(len(time), first + max(60, round(0.8 * before))))
    with drawing():
        figure, ax = subplots(8.6, 2.5)
        draw.over_time(ax, time, [("", reference)], f"reference [{unit_y}]", [start, end])
        page.section(f"Last trial: {_list([run.campaign.name for run in runs])}").figure(
            figure,
            "Reference",
            f"The motion starts at {start:g} s and ends at {end:g} s (dotted); before and after it "
            f"the machine stands. Counterpart of Figure 6 of {PAPER}.",
        )
        figure, axes = subplots(8.6, 6.2, 2, 2, width_ratios=[1.6, 1.0], sharex="col")
        for row, (curves, label) in enumerate(
            ((errors, f"error [{unit_y}]"), (forwards, f"feedforward [{unit_f}]"))
        ):
            draw.over_time(axes[row, 0], time, curves, label, [start, end])
            near = [(name, values[zoom]) for name, values in curves]
            draw.over_time(axes[row, 1], time[zoom], near, label, [start])
        axes[0, 0].set_xlabel("")
        axes[0, 1].set_xlabel("")
        axes[0, 0].set_title("whole trial")
        axes[0, 1].set_title("around the start of the motion")
        handles = axes[0, 0].get_lines()[: len(runs)]
        figure.legend(
            handles,
            [run.label for run in runs],
            loc="outside lower center",
            ncols=min(len(runs), IN_A_ROW),
        )
        told = "; ".join(
            f"{label} {n * campaign.sample_time * 1e3:g} ms" for label, n in early.items()
        )
        page.figure(
            figure,
            "Error and feedforward of the last trial",
            "Dotted lines: start and end of the motion. Left of the first one the reference is "
            "still at rest; feedforward that changes there is pre-actuation, which a plant with zeros "
            "outside the unit circle needs. By more than a thousandth of its largest change, f leaves its "
            f"first value before the motion by: {told}. Counterpart of Figure 8 of {PAPER}, where "
            "non-causal functions "
            "pre-actuate without limit and FIR by its three samples of preview.",
        )


def _plant(page: Page, runs: Sequence[FinishedRun]) -> None:
    campaign = runs[0].campaign
    t = campaign.sample_time
    frequencies = np.geomspace(0.1 if t < 0.1 else 1e-3 / t, 0.4999 / t, 1200)
    servo = campaign.model.controller is not None and not campaign.model.controller.one_degree
    what = "ideal 1/F" if servo else "P"
    plants = [(f"{what}, model {campaign.model.name}", to_invert(campaign.model, frequencies))]
    if _text(runs[0], "machine") != _text(runs[0], "model"):
        machine = campaign.machine
        plants.append((f"{what}, machine {machine.name}", to_invert(machine, frequencies)))
    inverses = []
    for index, run in enumerate(runs):
        response = run.response(frequencies)
        if response is not None and run.trials > 1:
            inverses.append((index, f"1/F, {run.label}", 1.0 / response))
    drawn = {index for index, _, _ in inverses}
    left_out = [run.label for index, run in enumerate(runs) if index not in drawn]
    f, total = cumulative_power(np.diff(campaign.reference, 2), t)
    share = total / total[-1]
    band = (max(float(f[np.searchsorted(share, 0.005)]), frequencies[0]),
            float(f[np.searchsorted(share, 0.995)]))  # fmt: skip
    unit = f"{_label(campaign.model.output_unit)}/{_label(campaign.model.input_unit)}"
    with drawing():
        page.section(f"Plant and learned inverse: {campaign.model.name}")
        figure, axes = subplots(8.6, 6.4, 2, 1, height_ratios=[1.5, 1.0], sharex=True)
        draw.bode(axes[0], axes[1], frequencies, plants, inverses, band, unit)
        page.figure(
            figure,
            "Plant P against the inverse of the learned feedforward, F⁻¹(θ)",
            (
                "The servo treats reference and output differently, so the ideal feedforward is "
                "1/P + C_y − C_r, and its inverse is drawn in the place of P. "
                if servo
                else ""
            )
            + "Where a coloured line lies on the dark ones, the feedforward inverts the plant. "
            "Shaded: the band that holds 99 % of the power of the reference's acceleration; "
            f"outside it ({band[0]:.2g} to {band[1]:.2g} Hz) nothing asks F to be right. Where a "
            "zero pair lies outside the unit circle the magnitude dips while the phase lags by a "
            f"further 180 degrees. Counterpart of Figures 2 and 9 (top) of {PAPER}."
            + (
                f" Not drawn: {', '.join(left_out)} (no filter of the reference, or nothing learned yet)."
                if left_out
                else ""
            ),
        )
        short, long = round(0.12 / t) if t < 0.02 else 30, round(1.0 / t) if t < 0.02 else 200
        response = campaign.model.system.impulse_response(long)
        figure, axes = subplots(8.6, 2.9, 1, 2)
        for ax, n in zip(axes, (short, long), strict=True):
            draw.impulse(ax, np.arange(n) * t, response[:n], unit)
        against = wrong_way(campaign.model.system, response)
        page.figure(
            figure,
            "Impulse response of the model",
            (
                "The output first moves against its final direction, for "
                f"{against * t * 1e3:g} ms: the zeros outside the unit circle at "
                "work, and the reason why a good feedforward starts before the motion does. "
                if against
                else "The output moves in its final direction from the start. "
            )
            + f"Left: the beginning. Counterpart of Figure 3 of {PAPER}.",
        )


def wrong_way(system: Zpk | StateSpace, response: Array) -> int:
    """Samples for which the impulse response (n,) begins against the direction of the gain at
    standstill, the limit of H(z) at z = 1: its first value has the sign of H's gain, and each real zero
    beyond +1 turns that of the limit once. An even number: none."""
    zeros = as_zpk(system).zeros
    beyond = np.sum((zeros.imag == 0) & (zeros.real > 1.0 + AT_ONE))
    moving = np.flatnonzero(response)
    if beyond % 2 == 0 or not len(moving):
        return 0
    turned = np.flatnonzero(response * np.sign(response[moving[0]]) < 0)
    return int((turned[0] if len(turned) else len(response)) - moving[0])


def to_invert(plant: Plant, frequencies: Array) -> Array:
    """What the feedforward has to invert: P, or 1/(1/P + C_y - C_r) where the controller treats
    reference and output differently."""
    response = plant.system.response(frequencies)
    if plant.controller is None or plant.controller.one_degree:
        return response
    difference = plant.controller.output.response(frequencies)
    difference = difference - plant.controller.reference.response(frequencies)
    return response / (1.0 + response * difference)


def _power(page: Page, runs: Sequence[FinishedRun]) -> None:
    groups = equal_error_weights(runs)
    columns = min(len(groups), 3)
    rows = -(-len(groups) // columns)
    with drawing():
        figure, axes = subplots(8.6, 3.2 * rows, rows, columns, squeeze=False, sharey=True)
        for ax in axes.ravel()[len(groups) :]:
            ax.set_visible(False)
        told = []
        for ax, (title, members) in zip(axes.ravel(), groups, strict=False):
            t = runs[members[0]].campaign.sample_time
            spectra = [cumulative_power(runs[k].signal("e"), t) for k in members]
            largest = max(total[-1] for _, total in spectra)
            curves = [
                (k, runs[k].label, f, 100 * total / largest)
                for k, (f, total) in zip(members, spectra, strict=True)
            ]
            draw.cumulative(ax, curves, t)
            ax.set_title(title)
            told += [f"{label} {percent[-1]:.3g} %" for _, label, _, percent in curves]
        for ax in axes[:, 1:].ravel():
            ax.set_ylabel("")
        page.section("Where the remaining error lies").figure(
            figure,
            "Normalised cumulative power spectrum of the last error",
            "Read at the right edge: all the power of e, in per cent of the largest of its group "
            f"(equal W_e): {'; '.join(told)}. A step marks a frequency at which error is left. "
            f"Counterpart of Figure 9 (bottom) of {PAPER}, where repeating the poles ends at 60 %.",
        )


def _parameters(page: Page, runs: Sequence[FinishedRun]) -> None:
    shown = [run for run in runs if not run.is_free and run.trials > 1]
    if not shown:
        return
    columns = min(len(shown), 4)
    rows = -(-len(shown) // columns)
    with drawing():
        figure, axes = subplots(8.6, 2.6 * rows, rows, columns, squeeze=False, sharey=True)
        for ax in axes.ravel()[len(shown) :]:
            ax.set_visible(False)
        for ax, run in zip(axes.ravel(), shown, strict=False):
            draw.parameters(ax, run.theta, run.label)
        axes[0, 0].set_ylabel("parameter / |its last value|")
        page.section("Parameters over the trials").figure(
            figure,
            "Parameters of every trial, each relative to its last value",
            "Every line ends at +1 or −1. Level lines: the parameters have converged. Lines that "
            "still wander belong to directions that the reference hardly excites: they change "
            "without changing the error.",
        )
    for run in shown:
        names = run.spec.basis.names
        if len(names) > 40:
            continue
        page.heading(f"Learned parameters: {run.label}")
        values = [[name, float(value)] for name, value in zip(names, run.theta[-1], strict=True)]
        page.table(["basis function", "θ, last trial"], values)


def _second(page: Page, runs: Sequence[FinishedRun]) -> None:
    carried = [run for run in runs if "second_reference" in run.entry]
    if not carried:
        return
    rows = []
    for run in carried:
        entry = run.entry["second_reference"]
        only, left = entry["error_norm_feedback_only"], entry["error_norm"]
        rows.append([run.label, only, left, left / only])
    page.section("A reference that was never learned").table(
        ["run", "‖e‖, feedback only", "‖e‖, parameters carried over", "left"],
        rows,
        "The parameters of the last trial, applied to the second reference without relearning: "
        "the extrapolation that is the point of basis functions.",
    )


def _how(page: Page, runs: Sequence[FinishedRun]) -> None:
    page.section("How this was made")
    for folder in dict.fromkeys(run.folder for run in runs):
        campaign = next(run.campaign for run in runs if run.folder == folder)
        page.text(f"Folder {folder}; seed {campaign.seed}; rerun it with: ffl rerun {folder}")
        page.pre(campaign.resolved["campaign.toml"])
