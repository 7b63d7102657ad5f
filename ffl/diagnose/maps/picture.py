"""A map beside its data: the signal that the recordings ask for at its port, along its variable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import discrete
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.terms import SIGNALS, variable
from ffl.diagnose.noise.passage import nothing
from ffl.diagnose.noise.wiener import Wiener, of_force
from ffl.diagnose.recorded.repeating import EDGE, Repeating
from ffl.diagnose.recorded.trials import Trial
from ffl.effects.modal import force_unit, is_speed
from ffl.machines.simulator import Simulator
from ffl.systems.state_space import Array, ComplexArray

CARRIED = 0.5  # of a signal of the map's size at one frequency, that the data carry it
CLEAR = 0.2  # of the driver's largest: where it is smaller, dividing by it shows noise


@dataclass(frozen=True)
class MapPicture:
    """`x`, `wanted` (N,): data; `grid`, `values` (k,): the map, or with `along` (N,): what it gives at
    every sample; `formula` (k,) where there is one; labels with units."""

    title: str
    x_label: str
    y_label: str
    x: Array
    wanted: Array
    grid: Array
    values: Array
    formula: Array | None
    along: bool = False


def picture(scene: Scene, free: FreeModel, index: int, said: Formula | None) -> MapPicture | None:
    """Map `index` of `free` on the recording that shows most of it."""
    part = free.parts[index]
    best: tuple[float, Trial] | None = None
    for trial in scene.trials:
        found = free.follow(trial, [part.place])
        if found is None:
            return None
        size = float(np.sum(part.signal(found[1][part.place]) ** 2))
        if best is None or size > best[0]:
            best = (size, trial)
    if best is None:
        return None
    trial = best[1]
    found = free.follow(trial, [part.place])
    assert found is not None
    motion = found[1][part.place]
    signal = part.signal(motion)
    wanted = _asked(scene, free, part, trial.y - found[0].y, signal)
    plant = free.model.base.plant
    scale = free.model.simulator.force_per_input if part.place.port == "force" else 1.0
    unit = _unit(free, part)
    title = f"{part.place.words}: {part.term.name}"
    place, speed, gain = (f"{plant.output_unit}{per}" for per in ("", "/s", "/s^2"))
    if is_speed(plant.output_unit):
        place, speed, gain = (f"{plant.output_unit}{per}" for per in (" s", "", "/s"))
    units = {"x": place, "v": speed, "a": gain, "u": plant.input_unit, "t": "s"}
    if part.term.grid is None or part.term.along_grid is None:
        # Of more than one variable, or of what was before.
        over = next((name for name in part.term.variables if name in SIGNALS), "time")
        x = variable(motion, SIGNALS.get(over, "t"))
        return MapPicture(
            title, f"{over} [{units[SIGNALS.get(over, 't')]}]", f"asked for and fitted [{unit}]",
            x, wanted * scale, x, signal * scale, None, True,
        )  # fmt: skip
    grid = part.term.grid(part.ranges)
    unity = part.term.along_grid(motion, grid, np.ones(len(grid)))
    clear = np.abs(unity) > CLEAR * np.abs(unity).max()
    name = SIGNALS.get(part.term.along, part.term.along)
    x = variable(motion, name)
    per = f" per {part.term.driver}" if part.term.driver else ""
    return MapPicture(
        title, f"{part.term.along} [{units[name]}]" if name in units else part.term.along,
        f"asked for and fitted{per}" + ("" if per else f" [{unit}]"),
        x[clear], (wanted[clear] / unity[clear]) * scale, grid, part.coefficients * scale,
        None if said is None else said.values,
    )  # fmt: skip


def over_time(same: Repeating, simulator: Simulator) -> MapPicture:
    """A disturbance that comes again: what each recording asks for, and what they have in common."""
    seen, scale = slice(0, len(same.load) - EDGE), simulator.force_per_input
    each = same.each[:, seen] * scale
    return MapPicture(
        "a force: the same in every recording", "time since the recording began [s]",
        f"asked for and shared [{force_unit(simulator.plant)}]", np.tile(same.t[seen], len(each)),
        each.ravel(), same.t[seen], same.load[seen] * scale, None,
    )  # fmt: skip


def _unit(free: FreeModel, part: Part) -> str:
    plant = free.model.base.plant
    if part.place.port == "output":
        return plant.output_unit or "output"
    return force_unit(plant) if part.place.port == "force" else plant.input_unit or "input"


def _asked(scene: Scene, free: FreeModel, part: Part, left: Array, signal: Array) -> Array:
    """The least signal at the port that explains what is left without the map: with it the residual is
    `left`, and what its own `signal` does to y comes back to first order. What the data do not carry is
    none, whatever the map says, but for what is slower than all they carry: that is the map's (a loop with
    an integrator hides a constant)."""

    def path(f: Array) -> ComplexArray:
        if part.place.port == "command":
            return of_force(scene.loop, f)
        seen = scene.loop.sensitivity.response(f)
        if part.place.port != "force":
            return seen
        mechanics = free.model.simulator.mechanics
        point = mechanics.point(part.place.side, part.place.mass_ratio)
        through = replace(mechanics, b=point.force, d=0.0, delay=0, exact=None)
        through = replace(through, fast=nothing(mechanics.sample_time))
        return seen * discrete(through).response(f)

    n, size = len(left), float(np.mean(signal**2))
    behind = Wiener(scene, n, path)
    own, power = np.fft.rfft(signal, 2 * n), np.abs(behind.path) ** 2
    carried = power / (power + behind.noise / max(size, 1e-300))
    slower = np.arange(len(carried)) < int(np.argmax(carried > CARRIED))
    done = np.fft.irfft(behind.path * own, 2 * n)  # what comes after the recording too
    done[:n] += left
    hidden = np.fft.irfft(np.where(slower, (1.0 - carried) * own, 0.0), 2 * n)[:n]
    return behind(done, size, None) + hidden
