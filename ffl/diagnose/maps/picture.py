"""A map beside its data: the signal that the recordings ask for at its port, along its variable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import discrete
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.terms import SIGNALS
from ffl.diagnose.noise.passage import nothing
from ffl.diagnose.noise.wiener import Wiener, of_force
from ffl.diagnose.recorded.trials import Trial
from ffl.effects.modal import force_unit, is_speed
from ffl.systems.state_space import Array, ComplexArray

CLEAR = 0.2  # of the driver's largest: where it is smaller, dividing by it shows noise


@dataclass(frozen=True)
class MapPicture:
    """`x`, `wanted` (N,): data; `grid`, `values` (k,): the map; `formula` (k,) where there is one; labels
    with units."""

    title: str
    x_label: str
    y_label: str
    x: Array
    wanted: Array
    grid: Array
    values: Array
    formula: Array | None


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
    wanted = signal + _beside(scene, free, part, trial.y - found[0].y, signal)
    plant = free.model.base.plant
    scale = free.model.simulator.force_per_input if part.place.port == "force" else 1.0
    unit = _unit(free, part)
    title = f"{part.place.words}: {part.term.name}"
    if part.term.grid is None or part.term.along_grid is None:
        edge = np.array([signal.min(), signal.max()]) * scale
        return MapPicture(
            title, f"map of {part.term.name} [{unit}]", f"asked for by the data [{unit}]",
            signal * scale, wanted * scale, edge, edge, None,
        )  # fmt: skip
    grid = part.term.grid(part.ranges)
    unity = part.term.along_grid(motion, grid, np.ones(len(grid)))
    clear = np.abs(unity) > CLEAR * np.abs(unity).max()
    name = SIGNALS[part.term.along]
    x = motion.t - motion.t.min() if name == "t" else getattr(motion, name)
    per = f" per {part.term.driver}" if part.term.driver else ""
    place, speed = plant.output_unit, f"{plant.output_unit}/s"
    if is_speed(plant.output_unit):
        place, speed = f"{plant.output_unit} s", plant.output_unit
    units = {"x": place, "v": speed, "u": plant.input_unit, "t": "s"}
    return MapPicture(
        title, f"{part.term.along} [{units[name]}]",
        f"asked for and fitted{per}" + ("" if per else f" [{unit}]"),
        x[clear], (wanted[clear] / unity[clear]) * scale, grid, part.coefficients * scale,
        None if said is None else said.values,
    )  # fmt: skip


def _unit(free: FreeModel, part: Part) -> str:
    plant = free.model.base.plant
    if part.place.port == "output":
        return plant.output_unit or "output"
    return force_unit(plant) if part.place.port == "force" else plant.input_unit or "input"


def _beside(scene: Scene, free: FreeModel, part: Part, e: Array, signal: Array) -> Array:
    """The least signal at the port that explains the residual `e`."""

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

    return Wiener(scene, len(e), path)(e, float(np.mean(signal**2)))
