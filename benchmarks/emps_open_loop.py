"""The published open-loop protocol of the EMPS benchmark on a model that was fitted elsewhere.

    python benchmarks/emps_open_loop.py runs/emps/augmented.toml DATA_EMPS_PULSES.mat \\
        --calibrate DATA_EMPS.mat

The recorded command drives the plant and its effects without the servo. Position and velocity at the
start are estimated from samples 0 to 19, the root mean square error of position counts from sample 20
on. Nothing brings back what a constant force drives away, so the figure is printed for offsets of
0.1 N either way too. `--calibrate` fits two numbers in open loop to another recording first: a
constant force, and one factor on all levels of friction.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.optimize

from ffl.effects import EFFECTS
from ffl.machines import Simulator
from ffl.recordings import Recording, read_recording
from ffl.systems import load_plant
from ffl.systems.plant import EffectSpec, Plant

START = 20  # samples that the start is estimated from
OFFSETS = (-0.1, 0.0, 0.1)  # N


def open_loop_errors(plant: Plant, recording: Recording, offset: float = 0.0) -> np.ndarray:
    """y - yhat of every sample, the start estimated from the first `START`; `offset` in newtons is
    added to the recorded command."""
    simulator = Simulator(replace(plant, controller=None), open_loop=True)
    command = recording.u + offset / simulator.force_per_input

    def errors(start: np.ndarray, samples: int) -> np.ndarray:
        run = simulator.run(plant.effects, None, command[:samples], start=start)
        return recording.y[:samples] - run.y

    start = simulator.at_rest(float(recording.y[0]))
    unit = np.eye(len(start)) * np.abs(start).max()
    for _ in range(4):  # Gauss and Newton; friction bends little over so few samples
        left = errors(start, START)
        columns = [left - errors(start + step, START) for step in unit]
        start = start + np.linalg.lstsq(np.column_stack(columns), left, rcond=1e-9)[0] @ unit
    return errors(start, len(recording))


def calibrated(plant: Plant, recording: Recording) -> Plant:
    """The plant with a constant load, and with the levels of its effects times one factor, that leave
    least of `recording` in open loop."""

    def changed(numbers: np.ndarray) -> Plant:
        load, factor = numbers
        effects = [_scaled(spec, factor) for spec in plant.effects]
        return replace(
            plant, effects=(*effects, EffectSpec("constant_load", {"force": float(load)}))
        )

    found = scipy.optimize.least_squares(
        lambda numbers: 1e3 * open_loop_errors(changed(numbers), recording)[START::START],
        [0.0, 1.0],
        x_scale=[0.5, 0.02],
        diff_step=2e-3,
    )
    return changed(found.x)


def _scaled(spec: EffectSpec, factor: float) -> EffectSpec:
    """Every force among the parameters times `factor`."""
    forces = {p.name for p in EFFECTS[spec.name].parameters if p.unit == "F"}
    values = dict(spec.parameters)
    for name in forces & set(values):
        if name != "table":
            values[name] = factor * values[name]
            continue
        sides = {k: [factor * v for v in values[name][k]] for k in ("positive", "negative")}
        values[name] = {**values[name], **sides}
    return replace(spec, parameters=values)


def rmse_mm(plant: Plant, recording: Recording, offset: float = 0.0) -> float:
    return float(1e3 * np.sqrt(np.mean(open_loop_errors(plant, recording, offset)[START:] ** 2)))


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "model", type=Path, help="plant file with effects, as `ffl diagnose` writes it"
    )
    parser.add_argument("recording", type=Path)
    parser.add_argument("--calibrate", type=Path, help="recording to fit two numbers to first")
    parser.add_argument("--map", default="emps")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    plant = load_plant(str(given.model))
    recording, *other = (
        read_recording(path, given.map, sample_time=plant.sample_time)
        for path in (given.recording, given.calibrate)
        if path is not None
    )
    if other:
        plant = calibrated(plant, other[0])
    result = {
        "rmse_mm": rmse_mm(plant, recording),
        **{f"rmse_mm_with_{o:+.1f}_N": rmse_mm(plant, recording, o) for o in OFFSETS if o},
        "terms": [spec.name for spec in plant.effects],
    }
    lines = "\n".join(f"{key}: {value}" for key, value in result.items())
    print(json.dumps(result, indent=1) if given.json else lines)


if __name__ == "__main__":
    main(sys.argv[1:])
