"""How loud may force noise be before the friction that free runs find is wrong, and what a filter finds.

Stages of the challenge (other equations, small steps) with Coulomb friction under white force noise from
3 % to three times its level. The level is fitted twice, to free runs and to what a filter that sticks and
slips leaves from sample to sample, in as many parts of one as are the likelier; mass and damping are free.

    python benchmarks/friction_in_noise.py [--machine rigid|stiffness] [--seeds 10] [--jobs 1]
        [--picture FILE.png] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _cases import read_case
from joblib import Parallel, delayed

from ffl.challenge import write
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.challenge.make import NullCase
from ffl.challenge.stage import Part, assemble, run
from ffl.diagnose.contest.dry import level_of
from ffl.diagnose.contest.judging import judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.foretold import refitted
from ffl.diagnose.predict.slipping import PARTS, Slip, finer
from ffl.diagnose.recorded.trials import prepare
from ffl.report.page import COLOURS, drawing, png_bytes, subplots
from ffl.systems import EffectSpec
from ffl.systems.atomic import write_bytes

NEAR = (0.25, 1.0, 3.0)  # times the level that free runs begin with: where the filter begins
LOUDNESS = (0.03, 0.1, 0.3, 1.0, 3.0)  # RMS force noise over the friction's level


def made(machine: str, seed: int, loud: float, home: Path) -> float:
    """Recordings and model of one stage in `home`; its level in units of the command."""
    rng = np.random.default_rng([seed, 41])
    setup = draw_setup(machine, "careful", rng)
    scales = measure(setup)
    build, (friction,) = assemble(setup, [Part("coulomb_friction", "motor", seed, 1.0)], scales)
    level = friction["level"] / setup.parameters["constant"]
    noise = replace(draw_noise(setup, scales, rng), force=loud * level, force_coloured=0.0)
    groups = [
        tuple(write.columns(e, *run(build, setup, e, noise, rng), setup.sample_time) for e in plan)
        for plan in (setup.fit, setup.validate)
    ]
    NullCase(machine, write.plant_text(setup, noise, None), *groups).save(home)
    return level


def one(machine: str, seed: int, loud: float) -> dict[str, float]:
    """Level found over the true one by free runs and by the filter, and what friction brings by either, in
    nats."""
    with tempfile.TemporaryDirectory() as folder:
        level = made(machine, seed, loud, Path(folder))
        plant, recordings, _ = read_case(Path(folder))
    base = Base.of(plant, max(float(np.ptp(r.y)) for r in recordings))
    level *= base.simulator.force_per_input
    sensor = float(np.hypot(plant.machine.sensor_noise, plant.machine.encoder_resolution / 12**0.5))
    noise = Noise(sensor, plant.machine.force_noise)
    scene = Scene(plant.loop, tuple(prepare(base.simulator, r, sensor) for r in recordings), noise)
    none = Model(base)
    rms = np.sqrt(np.mean(np.concatenate([t.u for t in scene.trials]) ** 2))
    begun = EffectSpec(
        "coulomb_friction", {"level": 0.2 * float(rms) * base.simulator.force_per_input}
    )
    free, bare = judge(scene, None, none.with_effect(begun), 12), judge(scene, None, none, 12)
    starts = [
        none.with_effect(replace(begun, parameters={"level": n * level_of(begun)})) for n in NEAR
    ]
    ways = [Slip(start, noise, parts) for start in starts for parts in PARTS]
    found = [refitted(way, scene.trials) for way in ways]
    told = finer(max(found, key=lambda way: way.worth(scene.trials)), scene.trials)
    plain = refitted(Slip(none, noise), scene.trials)
    return {
        "loudness": loud,
        "seed": seed,
        "free_runs": free.model.effects[0].parameters["level"] / level,
        "filter": told.model.effects[0].parameters["level"] / level,
        "free_runs_nats": free.fitted - bare.fitted,
        "filter_nats": told.scaled(scene.trials)[0] - plain.scaled(scene.trials)[0],
    }


def picture(rows: list[dict[str, float]], path: Path) -> None:
    figure, (left, right) = subplots(10.0, 3.8, 1, 2)
    for key, colour, said, shift in (
        ("free_runs", COLOURS[1], "free runs", 0.93),
        ("filter", COLOURS[0], "a filter that sticks and slips", 1.07),
    ):
        for axis, value in ((left, key), (right, f"{key}_nats")):
            at = np.array([r["loudness"] for r in rows]) * shift
            axis.plot(at, [r[value] for r in rows], "o", ms=3.5, alpha=0.45, color=colour)
            middle = [np.median([r[value] for r in rows if r["loudness"] == x]) for x in LOUDNESS]
            axis.plot(LOUDNESS, middle, color=colour, lw=1.8, label=said)
    left.axhline(1.0, color="0.4", lw=0.8, ls="--")
    left.set_ylim(0.0, 2.0)
    left.set_ylabel("level found / true level")
    right.set_yscale("symlog", linthresh=10.0)
    right.set_ylabel("log-likelihood over no friction")
    for axis in (left, right):
        axis.set_xscale("log")
        axis.set_xlabel("RMS force noise / level of friction")
    left.legend(loc="upper left")
    write_bytes(path, png_bytes(figure))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--machine", choices=("rigid", "stiffness"), default="rigid")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    rows = Parallel(asked.jobs)(
        delayed(one)(asked.machine, seed, loud) for loud in LOUDNESS for seed in range(asked.seeds)
    )
    if asked.picture:
        with drawing():
            picture(rows, asked.picture)
    if asked.json:
        print(json.dumps(rows))
        return
    print(
        "noise/level  free runs (median, 10 to 90 %)  filter (median, 10 to 90 %)    nats, either"
    )
    for loud in LOUDNESS:
        own = [r for r in rows if r["loudness"] == loud]
        said = []
        for key in ("free_runs", "filter"):
            low, middle, high = np.quantile([r[key] for r in own], [0.1, 0.5, 0.9])
            said.append(f"{middle:.3f} ({low:.2f} to {high:.2f})")
        nats = [np.median([r[f"{key}_nats"] for r in own]) for key in ("free_runs", "filter")]
        print(f"{loud:11.2f}  {said[0]:>30}  {said[1]:>26}  {nats[0]:8.0f} {nats[1]:8.0f}")


if __name__ == "__main__":
    main()
