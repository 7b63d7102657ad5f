"""Figures of a forward linear model; each draws what it is given and returns its axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ffl.identify.linear import LinearModel, Overlay, Rung
from ffl.report.page import COLOURS, MARKERS
from ffl.systems.state_space import Array

INK = "#1b1f24"


def order_ladder(ax: Axes, model: LinearModel) -> Axes:
    """Held-out (full) and estimation (hollow) NRMSE over the order; the chosen rung is ringed."""
    kinds = sorted({_kind(r) for r in model.ladder})
    for index, (delay, integrators, feedthrough) in enumerate(kinds):
        rungs = [r for r in model.ladder if _kind(r) == (delay, integrators, feedthrough)]
        orders = [r.structure.order for r in rungs]
        colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
        label = "held out"
        if len(kinds) > 1:
            label += f", delay {delay}, at 1: {integrators}" + ", feedthrough" * feedthrough
        ax.semilogy(orders, [r.held_out for r in rungs], marker=marker, color=colour, label=label)
        ax.semilogy(
            orders,
            [r.estimation for r in rungs],
            marker=marker,
            markerfacecolor="none",
            linestyle=":",
            color=colour,
            label="estimation" if index == 0 else None,
        )
    chosen = [r for r in model.ladder if r.structure == model.structure]
    ax.plot(
        [r.structure.order for r in chosen],
        [r.held_out for r in chosen],
        "o",
        markersize=14,
        markerfacecolor="none",
        color=INK,
        label="chosen",
    )
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlabel("order")
    ax.set_ylabel("NRMSE [1]")
    ax.legend()
    return ax


def _kind(rung: Rung) -> tuple[int, int, bool]:
    s = rung.structure
    return s.delay, s.integrators, s.feedthrough


def fit_overlay(ax: Axes, overlay: Overlay, unit: str = "", label: str = "model") -> Axes:
    """Measured output, the model's, and their difference over time."""
    ax.plot(overlay.time, overlay.measured, color=INK, linewidth=1.4, label="measured")
    ax.plot(overlay.time, overlay.output, color=COLOURS[0], linewidth=0.9, label=label)
    ax.plot(
        overlay.time,
        overlay.measured - overlay.output,
        color=COLOURS[1],
        linewidth=0.7,
        label="difference",
    )
    ax.set_xlabel("time [s]")
    ax.set_ylabel(f"output [{unit}]" if unit else "output")
    ax.legend(ncols=3)
    return ax


def magnitude_band(
    ax: Axes,
    frequencies: Array,
    response: Array,
    std: Array,
    unit: str = "1",
    z: float = 2.447747,
) -> Axes:
    """|P| over frequency with the band |P| ± z std (z = 2.45: the 95 % disc of a complex number)."""
    magnitude = np.abs(response)
    low = np.maximum(magnitude - z * std, magnitude * 1e-3)
    ax.fill_between(frequencies, low, magnitude + z * std, color=COLOURS[0], alpha=0.25, lw=0)
    ax.loglog(frequencies, magnitude, color=COLOURS[0])
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"|P| [{unit}]")
    return ax


def residual_correlations(axes: Sequence[Axes], model: LinearModel) -> Sequence[Axes]:
    """Autocorrelation of the residual (left), its correlation with the input (right), 99 % bounds."""
    for ax, test, label in zip(
        axes,
        (model.whiteness, model.independence),
        ("residual with itself [1]", "residual with input [1]"),
        strict=True,
    ):
        lags = np.arange(test.correlation.size)
        ax.axhspan(-test.bound, test.bound, color=COLOURS[0], alpha=0.15, lw=0)
        ax.vlines(lags, 0.0, test.correlation, color=INK)
        ax.set_xlabel("lag [samples]")
        ax.set_ylabel(label)
        ax.set_title(f"p = {test.p_value:.2g}", fontsize="medium")
    return axes
