"""The page of `ffl reproduce printer2018`: the paper's numbers and figures beside ours."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.campaign.printer2018 import INSIDE, OUTSIDE, Example, Printer2018, T
from ffl.report.page import COLOURS, LINES, Page, drawing, subplots


def example_bode(example: Example, ax: Any) -> Any:
    """Magnitude of G(z) and of the three fits (Figure 5, top)."""
    ax.loglog(
        example.frequencies, np.abs(example.true_response), color="#1b1f24", lw=2.2, label="G(z)"
    )
    for k, fit in enumerate(example.fits):
        ax.loglog(
            example.frequencies,
            np.abs(fit.response),
            color=COLOURS[k],
            ls=LINES[k + 1],
            label=f"{fit.name}: {100 * fit.relative_error:.1f} %",
        )
    ax.set(xlabel="frequency (Hz)", ylabel="magnitude", ylim=(1e-5, 20))
    ax.legend(title="relative L2 error")
    return ax


def example_impulse(example: Example, ax: Any) -> Any:
    """Two-sided impulse responses (Figure 5, bottom)."""
    ax.plot(0.02 * example.lags, example.true_impulse, color="#1b1f24", lw=2.2, label="G(z)")
    for k, fit in enumerate(example.fits):
        ax.plot(0.02 * example.lags, fit.impulse, color=COLOURS[k], ls=LINES[k + 1], label=fit.name)
    ax.set(xlabel="time (s)", ylabel="impulse response", xlim=(-5, 5))
    return ax


def machine_spread(result: Printer2018, ax: Any) -> Any:
    """||e_10|| of every run on every drawn machine, one line a machine."""
    names = ["fir", "fir_placed", "obf", "obf_1e5", "obf_repeated"]
    columns = [result.machine_runs.index(name) for name in names]
    for norms in result.machines:
        ax.semilogy(names, norms[columns], color="#b8c0c8", lw=0.7, marker=".", ms=3)
    ax.semilogy(
        names,
        np.median(result.machines, axis=0)[columns],
        color=COLOURS[1],
        marker="o",
        label="median",
    )
    ax.set(ylabel="2-norm of e_10 (m)")
    ax.legend()
    return ax


def inverse_error(result: Printer2018, ax: Any, exact: bool) -> Any:
    """|1 - P F(theta)|: where the learned filter is an inverse, on the machine or on the model."""
    frequencies = np.geomspace(0.1, 499.0, 700)
    plant = (result.model if exact else result.machine).system.response(frequencies)
    runs = result.exact if exact else result.trials
    for k, name in enumerate(("obf", "obf_repeated", "obf_q_q2")):
        psi = result.bases[name].response(frequencies)
        if psi is None or name not in runs:
            continue
        gap = np.abs(1.0 - plant * (psi @ runs[name][-1].theta))
        ax.loglog(frequencies, gap, color=COLOURS[k], ls=LINES[k], label=name)
    power = np.abs(np.fft.rfft(np.diff(result.reference, 2)))
    f = np.fft.rfftfreq(len(result.reference) - 2, T)[1:]
    label = "reference acceleration, relative"
    ax.loglog(f, power[1:] / power.max(), color="#8a939c", lw=0.8, zorder=0, label=label)
    where = "machine is the model, no noise" if exact else "machine as built, trial 10"
    ax.set(
        xlabel="frequency (Hz)", ylabel="|1 - P F|", ylim=(1e-10, 1e7), xlim=(0.1, 500), title=where
    )
    ax.legend(loc="upper left")
    return ax


def error_norms(result: Printer2018, ax: Any) -> Any:
    """||e_j|| over the trials (Figure 7)."""
    for k, (name, trials) in enumerate(result.trials.items()):
        ax.semilogy(
            [trial.number for trial in trials],
            [trial.error_norm for trial in trials],
            color=COLOURS[k],
            ls=LINES[k],
            marker="os^DvP"[k],
            ms=4,
            label=name,
        )
    ax.set(xlabel="trial", ylabel="2-norm of the tracking error (m)")
    ax.legend()
    return ax


def page(result: Printer2018) -> Page:
    """Everything measured, as one self-contained page."""
    made = Page(
        "The 2018 printer paper, reproduced",
        "Blanken, Isil, Koekebakker, Oomen: data-driven feedforward learning using non-causal "
        "rational basis functions. Its numbers beside ours; where ours flatter, why.",
    )
    made.section("Numbers").table(
        ["what", "paper", "ours", "unit", "n"],
        [[row.what, row.paper, row.ours, row.unit, row.n] for row in result.rows],
        "The paper measured 45 % and 23 % on a real printer. A linear machine that differs from its "
        "model by a few per cent flatters: nothing here is stiff, sticks or drifts.",
    )
    with drawing():
        figure, axes = subplots(8.6, 6.2, 2, 1)
        example_bode(result.example, axes[0])
        example_impulse(result.example, axes[1])
    made.section("Example 1").figure(
        figure,
        "Bode magnitude and two-sided impulse responses",
        "Figure 5 of the paper. A finite response of 100 terms is cut off at one second on either "
        "side; four rational functions with poles of twice the true damping already follow both "
        "tails, twelve (the poles three times) lie on the truth.",
    )
    with drawing():
        figure, ax = subplots()
        error_norms(result, ax)
    made.section("Ten trials on the machine as built").figure(
        figure,
        "Error norm per trial",
        "Figure 7 of the paper, with the runs of section IV-B. fir_placed has its ten taps where the "
        f"model says they do best: delays {', '.join(map(str, result.best_delays))} samples. obf_q_q2 "
        "has q and q^2 beside the nine functions.",
    )
    with drawing():
        figure, axes = subplots(8.6, 4.4, 1, 2, sharey=True)
        inverse_error(result, axes[0], exact=False)
        inverse_error(result, axes[1], exact=True)
    made.figure(
        figure,
        "Where the learned filter is an inverse",
        "The relative degree is 2, so the inverse grows with q^2, while the nine functions hold only "
        "q^0 beside their poles: they invert P where the reference has power (grey) and nowhere above. "
        "Adding q and q^2 puts the model's inverse into the span: where the machine is the model "
        "(right) it is then inverted at every frequency, to the weight on f. On the machine as built "
        "(left) the mismatch sets the floor and the two more parameters gain what they can: see the table.",
    )
    with drawing():
        figure, ax = subplots()
        machine_spread(result, ax)
    made.section("Other machines").figure(
        figure,
        "2-norm of e_10 on drawn machines",
        f"{len(result.machines)} machines whose frequencies, damping and gain are 2 to 10 % off the "
        "model, each with a mode the model leaves out, noise and encoder as built. One grey line a "
        "machine.",
    )
    made.section("How it was made").text(
        f"Poles inside: {_list(INSIDE)} (8). Poles outside: {_list(OUTSIDE)} (9). Weights: W_e = 50 "
        "or 1e5, W_f = 1e-7, W_df = 0, read as weighted squared 2-norms."
    )
    return made


def _list(roots: tuple[complex, ...]) -> str:
    return ", ".join(f"{complex(root):.4f}" for root in roots)
