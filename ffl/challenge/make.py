"""`ffl challenge make`: concealed recordings in one folder, their truth in another."""

from __future__ import annotations

import itertools
import json
import secrets
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffl.challenge import write
from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build
from ffl.challenge.case import make_case
from ffl.challenge.compose import Plan, compose
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.challenge.seal import begin, commit
from ffl.challenge.stage import run
from ffl.errors import InputError, WorkError
from ffl.systems.atomic import require_folder, write_text


def _one(job: tuple[Plan, str, Path, Path]) -> str:
    """Make one case on the first of its machines that allows it; returns its kind."""
    plan, name, out, truths = job
    path = truths / f"{name}.json"
    if path.is_file():
        return plan.kind
    failure: Exception | None = None
    # Where no machine allows the plan, other draws of the same plan do; seldom needed.
    for again, machine in itertools.product(range(4), plan.machines):
        try:
            truth = make_case(
                plan.seed + again,
                plan.effects or None,
                machine,
                plan.concealment,
                out_dir=out,
                name=name,
                doubt=plan.doubt,
                fault=plan.fault,
                oracle=plan.kind in ("single", "several", "outside"),
            )
        except (WorkError, InputError) as error:
            failure = error
            continue
        truth["salt"] = secrets.token_hex(32)
        write_text(path, json.dumps(truth, indent=1, sort_keys=True) + "\n")
        return plan.kind
    raise WorkError(f"{name} ({plan.kind}, {plan.effects}): {failure}")


def make(
    out_dir: Path | str,
    truth_dir: Path | str,
    seed: int,
    fraction: float = 1.0,
    jobs: int = 1,
) -> dict:
    """Make a challenge; a broken-off run goes on where it stopped.

    Writes `truth_dir/challenge.seed`, `out_dir/case_0001/` ..., `truth_dir/case_0001.json` ... and,
    last, the commitments `out_dir/commitments.json`, whose content it returns. The salts come from
    the operating system, so hashes differ from run to run though the cases of one seed do not.
    """
    out, truths = Path(out_dir), Path(truth_dir)
    if out.resolve() == truths.resolve() or out.resolve() in truths.resolve().parents:
        raise InputError(f"{truths}: the truth must not lie in the folder of the cases ({out})")
    require_folder(out)
    require_folder(truths, "--truth")
    if seed < 0:
        raise InputError(f"seed = {seed} must not be negative")
    if jobs < 1:
        raise InputError(f"jobs = {jobs} must be at least 1")
    if not 0 < fraction <= 1:
        raise InputError(f"fraction = {fraction} must lie above 0 and at most at 1")
    plans = compose(seed, fraction)
    begin(truths, seed, fraction)
    digits = max(4, len(str(len(plans))))
    work = [(p, f"case_{k + 1:0{digits}d}", out, truths) for k, p in enumerate(plans)]
    if jobs > 1:
        with ProcessPoolExecutor(jobs) as pool:
            kinds = list(pool.map(_one, work, chunksize=4))
    else:
        kinds = [_one(job) for job in work]
    counts = {k: kinds.count(k) for k in sorted(set(kinds))}
    return commit(out, truths, {"fraction": fraction, "counts": counts})


@dataclass(frozen=True)
class NullCase:
    """Recordings in which nothing is missing, and the plant file's text.

    Each recording is an array (n_samples, 5) with the columns t, r, f, u, y.
    """

    machine: str
    plant: str
    fit: tuple[np.ndarray, ...]
    validate: tuple[np.ndarray, ...]

    def save(self, folder: Path | str) -> None:
        """Write the case as `make` would: plant.toml, fit_*.csv, validate_*.csv."""
        home = Path(folder)
        write_text(home / "plant.toml", self.plant)
        for label, recordings in (("fit", self.fit), ("validate", self.validate)):
            for k, rows in enumerate(recordings):
                write.table(home / f"{label}_{k + 1}.csv", rows)


def null_case(number: int, seed: int, machines: tuple[str, ...] = tuple(FAMILIES)) -> NullCase:
    """A cheap case with nothing left out; depends on `seed` and `number` alone. About 0.1 s.

    Nominal parameters are off as a careful engineer has them (mass up to 0.6 %).
    """
    rng = np.random.default_rng([seed, 9, number])
    setup = draw_setup(machines[number % len(machines)], "careful", rng)
    noise = draw_noise(setup, measure(setup), rng)
    groups = []
    for plan in (setup.fit, setup.validate):
        rows = []
        for e in plan:
            y, u = run(Build.of(setup.true), setup, e, noise, rng)
            rows.append(write.columns(e, y, u, setup.sample_time))
        groups.append(tuple(rows))
    return NullCase(setup.family, write.plant_text(setup, noise, None), *groups)


def null_recordings(
    count: int, seed: int, machines: tuple[str, ...] = tuple(FAMILIES)
) -> Iterator[NullCase]:
    """`null_case` 0 .. count - 1: several loops, noises and trajectories."""
    for number in range(count):
        yield null_case(number, seed, machines)
