"""`ffl identify linear`: a forward linear model as a plant file, and its page."""

from __future__ import annotations

import numpy as np

from ffl.effects import is_speed
from ffl.identify.linear import best_linear
from ffl.report import linear_figures as draw
from ffl.report.identified import Found, Task, identified_page
from ffl.report.page import drawing, subplots


def linear(task: Task) -> Found:
    """Order, delay and feedthrough by held-out error; the offset as a load where it is significant."""
    controller = task.model.controller if task.model is not None else None
    model = best_linear(task.recordings, task.orders, controller=controller, feedthrough=None)
    first = task.recordings[0]
    units = first.units
    plant = model.plant("identified", units.get("u", ""), units.get("y", ""), with_load=True)
    page = identified_page("linear", first)
    summary = model.summary()
    summary = {"criterion": summary.pop("method"), **summary}
    if (load := model.constant_load(is_speed(plant.output_unit))) is not None:
        summary |= {"constant_load": load[0], "constant_load_std_error": load[1]}
    page.section("Model").facts(
        [
            ("order", summary["order"]),
            ("error of the free run (NRMSE)", summary["nrmse"]),
            ("residual white, p", summary["whiteness_p"]),
        ]
    )
    with drawing():
        figure, axes = subplots(8.6, 3.6, 1, 2)
        draw.order_ladder(axes[0], model)
        model.plot(axes[1])
    page.figure(
        figure,
        "Order by held-out error, poles and zeros",
        "The chosen order is the smallest whose held-out error is as good as the best; a curve of "
        "the estimation data that falls on is fitting noise.",
    )
    f = np.geomspace(1.0 / first.duration, 0.499 / first.sample_time, 400)
    with drawing():
        figure, axes = subplots(8.6, 6.0, 2, 1)
        draw.magnitude_band(axes[0], f, model.response(f), model.response_std(f))
        draw.fit_overlay(axes[1], model.overlay(first), units.get("y", ""))
    page.figure(
        figure,
        "Frequency response and free run",
        "Magnitude with its 95 % band, and the model's free-running simulation over the recording.",
    )
    with drawing():
        figure, axes = subplots(8.6, 2.8, 1, 2)
        draw.residual_correlations(axes, model)
    page.figure(
        figure,
        "What the model leaves",
        "Bars beyond the band: structure the model leaves in the residual, or (right) response to "
        "the input that it misses; `ffl diagnose` asks what it is.",
    )
    return Found(summary, page, model.remarks, plant)
