"""The pictures of reports/real_recordings.md: the answers' own plant files, simulated again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
from _recordings import KNOWN, ROOT, SILVERBOX, TANKS, UNIFORM, Case, found
from emps_open_loop import START, calibrated, open_loop_errors
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffl.diagnose.predict.observer import decay_for, led, moving, with_observer
from ffl.diagnose.proof.prove import Overlay, run_plant
from ffl.diagnose.recorded.trials import blocks, prepare
from ffl.diagnose.recorded.where import Forces
from ffl.diagnose.transmission.encoders import Smoother
from ffl.diagnose.transmission.transmission import transmission
from ffl.effects.cascade import BETWEEN
from ffl.effects.position_dependent_friction import is_cubic
from ffl.errors import InputError
from ffl.machines import Simulation, Simulator
from ffl.recordings import Recording, read_recording
from ffl.report import diagnosis_figures as draw
from ffl.report.page import COLOURS, drawing, png_bytes, subplots
from ffl.report.transmission import over_time, over_torque
from ffl.systems import Plant, load_plant
from ffl.systems.atomic import write_bytes

Array = np.ndarray
WIDTH = 1045  # pixels of a picture


def stated(case: Case) -> Plant:
    return load_plant(ROOT / "plants" / f"{case.plant}.toml")


def augmented(case: Case, keep: Path) -> Plant:
    return load_plant(keep / case.name / "augmented.toml")


def values(plant: Plant, name: str) -> dict[str, Any]:
    """Parameters of an effect; raises `InputError` where the answer does not name it."""
    for spec in plant.effects:
        if spec.name == name:
            return dict(spec.parameters)
    raise InputError(f"{plant.name}: '{name}' was not named, and the picture is of it")


def read(case: Case, file: str) -> Recording:
    return read_recording(found(file), case.mapping)


def simulated(plant: Plant, recording: Recording, rows: int = 0) -> Simulation:
    """A free run from the recording's own start; with `rows` from the one that fits so many samples
    best."""
    trial = prepare(Simulator(plant), recording, 1e-3 * float(np.std(recording.y)))
    head = trial.head(rows)

    def errors(start: Array) -> Array:
        return head.y - run_plant(plant, replace(head, start=start)).y

    start = scipy.optimize.least_squares(errors, trial.start).x if rows else trial.start
    return run_plant(plant, replace(trial, start=start))


def before_and_after(case: Case, keep: Path, file: str) -> Overlay:
    """A recording beside the plant as shipped and as diagnosed."""
    x = read(case, file)
    before, after = (simulated(plant, x) for plant in (stated(case), augmented(case, keep)))
    return Overlay(file, x.t, x.y, x.u, before.y, before.u, after.y, after.u)


def part(o: Overlay, rows: slice) -> Overlay:
    names = ("t", "y", "u", "y_before", "u_before", "y_after", "u_after")
    return replace(o, **{name: getattr(o, name)[rows] for name in names})


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def above(axes: Sequence[Axes]) -> None:
    """Legends over the axes, where no curve is."""
    for ax in axes:
        ax.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.98))


def draw_ced(keep: Path) -> Figure:
    """The last 200 samples of the second set, in a free run of all 500."""
    o = part(before_and_after(KNOWN["ced"], keep, f"{UNIFORM}::uniform_2"), slice(300, None))
    figure, axes = subplots(9.5, 5.0, 2, 1, sharex=True)
    draw.overlay(axes[0], o, "ticks/s")
    axes[0].set_title("second set, last 200 samples")
    draw.errors(axes[1], o, "ticks/s")
    axes[1].set_title(f"RMS {rms(o.y - o.y_before):.3f} before, {rms(o.y - o.y_after):.3f} after")
    above(axes)
    return figure


def draw_silverbox(keep: Path) -> Figure:
    """The arrow's loudest quarter of a second, and the error over all of it."""
    o = before_and_after(KNOWN["silverbox"], keep, f"{SILVERBOX}::arrow")
    top = int(np.argmax(np.abs(o.y)))
    figure, axes = subplots(9.5, 5.4, 2, 1)
    draw.overlay(axes[0], part(o, slice(max(top - 75, 0), top + 75)), "V")
    axes[0].set(title="arrow where it is loudest", xlabel="time [s]")
    left = ((o.y - o.y_before, 1, "before"), (o.y - o.y_after, 0, "after"))
    for error, colour, when in left:
        axes[1].plot(o.t, 1e3 * error, color=COLOURS[colour], linewidth=0.7, label=when)
    axes[1].set(
        title="whole arrow, RMS " + ", ".join(f"{1e3 * rms(e):.2f} mV {w}" for e, _, w in left),
        xlabel="time [s]",
        ylabel="y - simulation [mV]",
    )
    above(axes)
    return figure


def draw_tanks(keep: Path) -> Figure:
    """The test part from a start that fits its first ten samples: both tanks, and the error."""
    case = KNOWN["tanks"]
    x, plant = read(case, f"{TANKS}::test"), augmented(case, keep)
    before, after = (simulated(model, x, 10) for model in (stated(case), plant))
    limit = values(plant, "sensor_nonlinearity")["level"]
    height = values(plant, "overflow")["height"]
    upper = next(after.positions[:, k] for (side, _), k in after.sides.items() if side in BETWEEN)
    figure, (level, stage, error) = subplots(
        9.5, 6.6, 3, 1, sharex=True, height_ratios=(1.8, 1.0, 1.0)
    )
    minutes = x.t / 60.0
    lines = (
        (x.y, 6, "measured"),
        (before.y, 1, "linear model"),
        (after.y, 0, "with what was named"),
    )
    for y, colour, label in lines:
        left = "" if y is x.y else f", RMS error {rms(x.y - y):.3f} V"
        level.plot(minutes, y, color=COLOURS[colour], label=label + left)
        if left:
            error.plot(minutes, x.y - y, color=COLOURS[colour])
    stage.plot(minutes, upper, color=COLOURS[0])
    for ax, at, label in ((level, limit, "sensor's end"), (stage, height, "overflow (shaded)")):
        ax.axhline(at, linestyle="--", linewidth=0.9, color="0.35")
        ax.text(minutes[-1], at, label, color="0.35", ha="right", va="bottom", fontsize=9)
    for ax in (level, stage, error):
        ax.fill_between(minutes, 0, 1, upper >= height - 1e-6, transform=ax.get_xaxis_transform(),
                        color="0.9", linewidth=0)  # fmt: skip
    level.set(ylabel="lower tank [V]", xlim=(minutes[0], minutes[-1]))
    stage.set(ylabel="upper tank,\nsimulated [V]")
    error.set(ylabel="y - simulation [V]", xlabel="time [min]")
    above([level])
    return figure


def balance(plant: Plant, mass: float, x: Recording, cut: float) -> tuple[Array, Array]:
    """(t, m a - u - d) below `cut` Hz, in the unit of the force: all that acts beside command and known
    load. Of what was simulated that is the sum of what was named."""
    step = x.sample_time
    a = np.gradient(np.gradient(x.y, step), step)
    drive = x.u if x.d is None else x.u + x.d
    force = Simulator(plant).force_per_input * smoothed(drive, step, cut, held=True)
    return smoothed(x.t, step, cut), mass * smoothed(a, step, cut) - force


def smoothed(x: Array, step: float, cut: float, held: bool = False) -> Array:
    """`x` after a Gaussian of -3 dB at `cut` Hz, without the ends that it does not reach; what is `held`
    for a sample acts half a sample later."""
    smooth = replace(Smoother.at(cut, step), every=1)
    return smooth(x, 0, -0.5 * step if held else 0.0, smooth.margin(step))


def draw_kuka(keep: Path) -> Figure:
    """Force that the rigid model lacks, below 10 Hz, and the sum of what was named."""
    figure, axes = subplots(9.5, 5.2, 2, 3)
    for k, ax in enumerate(axes.flat, 1):
        case = KNOWN[f"kuka{k}"]
        x = read(case, case.fit[0])
        observer = with_observer(stated(case), decay_for([x])).controller
        plant = replace(augmented(case, keep), controller=observer)
        (moved,) = led(moving([x]))
        (fitted,), (judged,) = blocks([moved])
        run = simulated(plant, moved)
        told = replace(moved, y=run.y, u=run.u)
        for stretch, colour in ((fitted, "0.92"), (judged, "#dbe8fb")):
            ax.axvspan(stretch.t[0], stretch.t[-1], color=colour, linewidth=0)
        ax.plot(*balance(plant, run.mass, x, 10.0), color=COLOURS[0], linewidth=1.0,
                label="m a - u - d, measured")  # fmt: skip
        ax.plot(*balance(plant, run.mass, told, 10.0), color=COLOURS[1], label="what was named")
        ax.set(title=f"axis {k}", xlim=(x.t[0], x.t[-1]))
        if k % 3 == 1:
            ax.set_ylabel("torque [N m]")
        if k > 3:
            ax.set_xlabel("time [s]")
    one_legend(figure, axes[0, :1])
    return figure


def draw_encoders(keep: Path) -> Figure:
    """Axes 1 to 3: what the encoders differ by, over time and over torque."""
    figure, axes = subplots(13.0, 6.0, 2, 3)
    for k, (upper, lower) in enumerate(axes.T, 1):
        case = KNOWN[f"kuka{k}_both"]
        told = transmission(stated(case), [read(case, case.fit[0])])
        assert told is not None
        over_time(upper, told.drawn[0], told.unit)
        over_torque(lower, told.drawn[0], told.unit, told.force)
        upper.set_title(f"axis {k}", loc="center")
    one_legend(figure, axes[:, 0])
    return figure


def one_legend(figure: Figure, shown: Sequence[Axes]) -> None:
    """The legends of the axes `shown` as one above the figure; the others have none."""
    pairs = [ax.get_legend_handles_labels() for ax in shown]
    for ax in figure.axes:
        if ax.get_legend():
            ax.get_legend().remove()
    handles, labels = ([*chain(*lists)] for lists in zip(*pairs, strict=True))
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels), markerscale=2)


def emps_forces(file: str, plant: Plant) -> Forces:
    """Force that the mass alone lacks in a recording of EMPS, and what was named, below 25 Hz."""
    x = read(KNOWN["emps"], file)
    run = simulated(plant, x)
    told = replace(x, y=run.y, u=run.u)
    wanted, fitted = (balance(plant, run.mass, s, 25.0)[1] for s in (x, told))
    step = x.sample_time
    position, velocity = (smoothed(s, step, 25.0) for s in (x.y, np.gradient(x.y, step)))
    return Forces(position, velocity, wanted, fitted, plant.input_unit, plant.output_unit)


def draw_emps_force(keep: Path) -> Figure:
    """Force that the mass alone lacks in DATA_EMPS, over velocity and over position."""
    forces = emps_forces(KNOWN["emps"].fit[0], augmented(KNOWN["emps"], keep))
    figure, axes = subplots(9.5, 4.0, 1, 2)
    for ax, variable in zip(axes, ("velocity", "position"), strict=True):
        draw.force_against(ax, forces, variable)
    one_legend(figure, axes[:1])
    return figure


def draw_emps_table(keep: Path) -> Figure:
    """Levels of dry friction named, and by least squares on the balance of forces of PULSES."""
    case = KNOWN["emps"]
    plant = augmented(case, keep)
    table = values(plant, "position_dependent_friction")["table"]
    viscous = values(plant, "viscous_friction")["coefficient"]
    forces = emps_forces(case.judge[0], plant)
    dry = forces.wanted + viscous * forces.velocity
    units = np.eye(len(table["grid"]))
    compared = {"grid": table["grid"]}
    for key, sign in (("positive", 1.0), ("negative", -1.0)):
        rows = sign * forces.velocity > 0.02  # m/s: beyond standstill and what eases near it
        hats = [np.interp(forces.position[rows], table["grid"], unit) for unit in units]
        compared[key] = np.linalg.lstsq(np.transpose(hats), -sign * dry[rows], rcond=None)[0]
    figure, ax = subplots(9.5, 4.0)
    smooth = any(is_cubic(spec.options) for spec in plant.effects)
    draw.friction_table(ax, table, plant.input_unit, plant.output_unit, smooth=smooth)
    draw.friction_table(ax, compared, plant.input_unit, plant.output_unit, ", PULSES alone")
    one_legend(figure, [ax])
    return figure


def draw_emps_errors(keep: Path) -> Figure:
    """PULSES in the loop, and in open loop as diagnosed and calibrated."""
    case = KNOWN["emps"]
    plant, (fit, judge) = augmented(case, keep), (read(case, f) for f in (*case.fit, *case.judge))
    figure, axes = subplots(9.5, 5.6, 2, 1)
    o = before_and_after(case, keep, case.judge[0])
    micro = replace(o, **{name: 1e6 * getattr(o, name) for name in ("y", "y_before", "y_after")})
    draw.errors(axes[0], micro, "um")
    axes[0].set_title("PULSES, closed loop")
    said = (
        ("as diagnosed", plant),
        ("two numbers calibrated on DATA_EMPS", calibrated(plant, fit)),
    )
    for label, model in said:
        error = 1e3 * open_loop_errors(model, judge)
        axes[1].plot(judge.t, error, label=f"{label}: {rms(error[START:]):.2f} mm")
    axes[1].set(title="PULSES, open loop", xlabel="time [s]", ylabel="y - simulation [mm]")
    above(axes)
    return figure


# What each picture needs, and who draws it.
PICTURES: dict[str, tuple[tuple[str, ...], Callable[[Path], Figure]]] = {
    "real_kuka.png": (tuple(f"kuka{k}" for k in range(1, 7)), draw_kuka),
    "real_ced.png": (("ced",), draw_ced),
    "real_tanks.png": (("tanks",), draw_tanks),
    "real_silverbox.png": (("silverbox",), draw_silverbox),
    "real_kuka_encoders.png": (tuple(f"kuka{k}_both" for k in range(1, 4)), draw_encoders),
    "emps_force.png": (("emps",), draw_emps_force),
    "emps_table.png": (("emps",), draw_emps_table),
    "emps_errors.png": (("emps",), draw_emps_errors),
}


def draw_all(chosen: set[str], keep: Path, folder: Path) -> None:
    """Every picture of which all recordings are `chosen`."""
    for file, (needs, picture) in PICTURES.items():
        if chosen >= set(needs):
            with drawing():
                figure = picture(keep)
                content = png_bytes(figure, int(WIDTH / figure.get_figwidth()))
            write_bytes(folder / file, content)
