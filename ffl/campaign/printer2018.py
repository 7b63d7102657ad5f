"""The 2018 printer paper, reproduced: every figure and number beside the paper's own.

Source: Blanken et al. 2018, Data-driven feedforward learning using non-causal rational basis
functions; equations (6) to (9), Example 1, section IV.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed
from numpy.random import SeedSequence

from ffl.bases import FIR, OBF, Basis, SumBasis
from ffl.identify.row import Row
from ffl.learn import LearningTask, NormOptimal, Trial, Weights, learn
from ffl.machines import SimulatedMachine
from ffl.systems import (
    Imperfections,
    Move,
    Plant,
    Zpk,
    as_zpk,
    load_plant,
    moves,
    two_sided_impulse,
    zero_order_hold,
)
from ffl.systems.perturb import mode, perturbed
from ffl.systems.state_space import Array

T = 1e-3
INSIDE = (0.9039, 0.9853, 0.9854 + 0.0457j, 0.9854 - 0.0457j, 0.9988)  # (8)
OUTSIDE = (1.008 + 0.0477j, 1.008 - 0.0477j, 1.078)  # (9), where the poles really lie
PAPER_WEIGHTS = Weights(50.0, 1e-7, 0.0)  # section IV-A
STRONG_WEIGHTS = Weights(1e5, 1e-7, 0.0)  # section IV-B
TRIALS = 10
MACHINES = 50
FAST_MACHINES = 8

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class ExampleFit:
    """Example 1: an L2 fit of G(z), its response on `frequencies` (Hz), its impulse response."""

    name: str
    response: Array
    impulse: Array
    relative_error: float


@dataclass(frozen=True)
class Example:
    """Example 1 of the paper (Figure 5). `lags` are the samples of the impulse responses."""

    frequencies: Array
    lags: Array
    true_response: Array
    true_impulse: Array
    fits: tuple[ExampleFit, ...]


@dataclass(frozen=True)
class Printer2018:
    """Everything `ffl reproduce printer2018` measured.

    `machines` has one row per drawn machine: ||e_10|| of the runs named in `machine_runs`.
    `carried` maps a run to (norm on a second reference with carried-over parameters, with feedback
    only, after ten trials of its own there).
    """

    rows: tuple[Row, ...]
    example: Example
    reference: Array
    trials: dict[str, list[Trial]]
    bases: dict[str, Basis]
    model: Plant
    machine: Plant
    machine_runs: tuple[str, ...]
    machines: Array
    best_delays: tuple[int, ...]
    carried: dict[str, tuple[float, float, float]]
    exact: dict[str, list[Trial]]


def reference_signal() -> Array:
    """The reference of campaigns/flatbed_printer.toml: out, back, out, at rest in between."""
    return moves(
        [Move(s, d, 0.6, 3.0, 60.0) for s, d in ((1.5, 0.3), (3.5, -0.3), (5.5, 0.3))], 8.0, T
    )


def second_reference() -> Array:
    """A task never learned: other distances, speeds and pauses."""
    return moves(
        [
            Move(1.2, 0.12, 0.35, 2.0, 40.0),
            Move(2.9, 0.25, 0.5, 2.5, 80.0),
            Move(5.2, -0.37, 0.7, 2.0, 50.0),
        ],
        8.0,
        T,
    )


def bases_of_the_paper() -> dict[str, tuple[Basis, Weights]]:
    """The four runs of section IV."""
    obf = OBF(INSIDE, OUTSIDE, True, 1, T)
    return {
        "fir": (FIR(3, 6, sample_time=T), PAPER_WEIGHTS),
        "obf": (obf, PAPER_WEIGHTS),
        "obf_1e5": (obf, STRONG_WEIGHTS),
        "obf_repeated": (OBF(INSIDE, OUTSIDE, True, 2, T), STRONG_WEIGHTS),
    }


def example_1() -> Example:
    """Example 1: 100th-order FIR, 4th- and 12th-order OBF fitted to G(z) in L2.

    The basis is orthonormal, so the parameters are inner products of impulse responses. The poles
    of the models have twice the true damping; the 12th-order model repeats them three times.
    """
    t = 0.02

    def continuous(frequency: float, damping: float) -> Array:
        w = 2 * np.pi * frequency
        root = -damping * w + 1j * abs(w) * np.sqrt(1 - damping**2)
        return np.array([root, root.conjugate()])

    poles = np.concatenate([continuous(1.0, 0.1), continuous(-0.5, 0.2)])
    gain = (2 * np.pi * 1.0) ** 2 * (2 * np.pi * 0.5) ** 2
    system: Zpk = as_zpk(zero_order_hold([], poles, gain, t))
    reach = 2500
    lags = np.arange(-reach, reach + 1)
    true = two_sided_impulse(system, reach, reach)
    frequencies = np.geomspace(0.05, 24.9, 500)
    transform = np.exp(-2j * np.pi * np.outer(frequencies, lags) * t)
    stable = mode(1.0, 0.2, t)
    unstable = np.exp(continuous(-0.5, 0.4) * t)
    fits = []
    taps = np.where((lags >= -50) & (lags < 50), true, 0.0)
    fits.append(("FIR, 100 parameters", taps))
    for repeat in (1, 3):
        phi = OBF(stable, unstable, repeat=repeat, sample_time=t).impulse_responses(reach, reach)
        fits.append((f"OBF, {4 * repeat} parameters", phi @ (phi.T @ true)))
    norm = np.linalg.norm(true)
    return Example(
        frequencies,
        lags,
        system.response(frequencies),
        true,
        tuple(
            ExampleFit(name, transform @ fit, fit, float(np.linalg.norm(true - fit) / norm))
            for name, fit in fits
        ),
    )


def run_seed(seed: int, name: str) -> SeedSequence:
    """Seed of a named run: independent of the order in which runs are made."""
    return SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),))


def learn_trials(
    model: Plant,
    machine: Plant,
    basis: Basis,
    weights: Weights,
    reference: Array,
    seed: SeedSequence,
) -> list[Trial]:
    task = LearningTask(model, SimulatedMachine(machine), basis, reference, weights)
    return list(learn(task, TRIALS, seed))


def place_taps(model: Plant, reference: Array, coarse: bool) -> tuple[int, ...]:
    """The ten delays d0, d0 + s, ..., d0 + 9 s whose FIR leaves the least criterion on the model.

    What a user with the same model could choose beforehand: W_e = 50, W_f = 1e-7, no noise.
    """
    error = reference - model.loop.reference_to_output.filter(reference)
    spacings = (1, 5, 20, 60) if coarse else (1, 2, 3, 5, 8, 12, 20, 30, 45, 60, 80)
    shares = (0.2, 0.5) if coarse else (0.1, 0.2, 0.33, 0.5, 0.67, 0.8)
    best: tuple[float, tuple[int, ...]] = (np.inf, ())
    for spacing in spacings:
        for share in shares:
            first = -round(share * 9 * spacing)
            delays = [first + spacing * k for k in range(10)]
            problem = NormOptimal(
                model, FIR(delays=delays, sample_time=T), reference, PAPER_WEIGHTS
            )
            update = problem.update(np.zeros(10), error)
            left = error - problem.response @ update.theta
            cost = PAPER_WEIGHTS.cost(left, update.feedforward, update.feedforward)
            best = min(best, (cost, tuple(delays)))
    return best[1]


def _machine_norms(
    index: int, seed: int, reference: Array, delays: tuple[int, ...]
) -> tuple[list[float], int]:
    """||e_10|| of every run on the machine drawn with `index`."""
    model, built = load_plant("flatbed_printer"), load_plant("flatbed_printer_built")
    rng = np.random.default_rng(SeedSequence(seed, spawn_key=(9, index)))
    machine = replace(perturbed(model, rng, 0.02, 0.10), machine=built.machine)
    runs = bases_of_the_paper()
    runs["fir_placed"] = (FIR(delays=list(delays), sample_time=T), PAPER_WEIGHTS)
    norms = []
    for name, (basis, weights) in runs.items():
        trials = learn_trials(
            model, machine, basis, weights, reference, run_seed(seed + 1000 + index, name)
        )
        norms.append(trials[-1].error_norm)
    return norms, index


def learn_on_the_model(
    model: Plant, basis: Basis, reference: Array, seed: SeedSequence
) -> list[Trial]:
    """Three trials where the machine is the model, without noise, with next to no weight on f."""
    quiet = SimulatedMachine(replace(model, machine=Imperfections()))
    task = LearningTask(model, quiet, basis, reference, Weights(1e9, 1e-9))
    return list(learn(task, 3, seed))


def carry_over(
    model: Plant, machine: Plant, basis: Basis, weights: Weights, theta: Array, seed: SeedSequence
) -> tuple[float, float, float]:
    """||e|| on a reference never learned: parameters carried over, feedback only, relearned there."""
    reference = second_reference()
    runner = SimulatedMachine(machine)
    rng = np.random.default_rng(seed)
    carried = runner.run(reference, basis.regressors(reference) @ theta, rng)
    own = learn_trials(model, machine, basis, weights, reference, seed)
    return float(np.linalg.norm(reference - carried.y)), own[0].error_norm, own[-1].error_norm


def reproduce(
    fast: bool = False, jobs: int = 1, progress: Progress | None = None, seed: int = 1
) -> Printer2018:
    """Runs Example 1, section IV and the statistics over drawn machines.

    `fast` draws 8 machines instead of 50 and searches fewer tap placements. The numbers do not
    depend on `jobs`.
    """
    say = progress or (lambda fraction, text: None)
    say(0.0, "Example 1")
    example = example_1()
    model, machine = load_plant("flatbed_printer"), load_plant("flatbed_printer_built")
    reference = reference_signal()
    say(0.02, "ten best-placed FIR taps")
    delays = place_taps(model, reference, fast)
    runs = bases_of_the_paper()
    obf = runs["obf"][0]
    runs["fir_placed"] = (FIR(delays=list(delays), sample_time=T), PAPER_WEIGHTS)
    runs["obf_q_q2"] = (SumBasis([obf, FIR(delays=[-2, -1], sample_time=T)]), STRONG_WEIGHTS)
    trials: dict[str, list[Trial]] = {}
    carried: dict[str, tuple[float, float, float]] = {}
    for index, (name, (basis, weights)) in enumerate(runs.items()):
        say(0.05 + 0.02 * index, f"ten trials of {name}")
        own = run_seed(seed, name)
        trials[name] = learn_trials(model, machine, basis, weights, reference, own)
        theta = trials[name][-1].theta
        carried[name] = carry_over(model, machine, basis, weights, theta, run_seed(seed + 1, name))
    exact = {
        name: learn_on_the_model(model, runs[name][0], reference, run_seed(seed, name))
        for name in ("obf", "obf_q_q2")
    }
    n = FAST_MACHINES if fast else MACHINES
    norms = np.zeros((n, 5))
    work = Parallel(n_jobs=jobs, return_as="generator_unordered")(
        delayed(_machine_norms)(index, seed, reference, delays) for index in range(n)
    )
    for count, (values, index) in enumerate(work):
        norms[index] = values
        say(0.2 + 0.8 * (count + 1) / n, f"machine {count + 1} of {n}")
    rows = _rows(example, trials, norms, carried, exact)
    return Printer2018(
        rows,
        example,
        reference,
        trials,
        {name: basis for name, (basis, _) in runs.items()},
        model,
        machine,
        ("fir", "obf", "obf_1e5", "obf_repeated", "fir_placed"),
        norms,
        delays,
        carried,
        exact,
    )


def _rows(
    example: Example,
    trials: dict[str, list[Trial]],
    norms: Array,
    carried: dict[str, tuple[float, float, float]],
    exact: dict[str, list[Trial]],
) -> tuple[Row, ...]:
    last = {name: run[-1].error_norm for name, run in trials.items()}
    n = len(norms)
    fir, obf, strong, repeated, placed = norms.T

    def below(key: str, what: str, better: str, other: str, paper: float | None = None) -> Row:
        return Row(key, what, 1 - last[better] / last[other], "fraction", 1, paper=paper)

    def lost(key: str, what: str, where: Array) -> Row:
        return Row(key, f"machines on which {what}", float(np.sum(where)), "machines", n)

    rows = [
        below("obf_below_fir", "||e_10|| of OBF below FIR, as built", "obf", "fir", 0.45),
        below(
            "repetition_below_obf",
            "||e_10|| of repeated OBF below OBF, W_e = 1e5",
            "obf_repeated",
            "obf_1e5",
            0.23,
        ),
        below("obf_below_fir_placed", "OBF below ten well-placed FIR taps", "obf", "fir_placed"),
        below(
            "direct_terms_below_obf", "OBF with q, q^2 below OBF, W_e = 1e5", "obf_q_q2", "obf_1e5"
        ),
    ]
    gains = {
        "obf_below_fir": 1 - obf / fir,
        "repetition_below_obf": 1 - repeated / strong,
        "obf_below_fir_placed": 1 - obf / placed,
    }
    for key, gain in gains.items():
        for name, value in (("median", 50), ("p5", 5), ("p95", 95)):
            what = f"{key}, {name} over machines 2 to 10 % off"
            rows.append(
                Row(f"{key}_{name}", what, float(np.percentile(gain, value)), "fraction", n)
            )
    rows += [
        lost("obf_loses_to_fir", "OBF leaves more error than FIR", obf > fir),
        lost("obf_loses_to_fir_placed", "OBF leaves more than placed FIR", obf > placed),
        lost("repetition_loses", "repetition leaves more than once", repeated > strong),
    ]
    for name, (moved, feedback, own) in carried.items():
        left = f"{name}, a reference never learned: error left of that with feedback only"
        rows.append(Row(f"carried_{name}", left, moved / feedback, "fraction", 1))
        again = f"{name}: the same after ten trials on that reference"
        rows.append(Row(f"relearned_{name}", again, own / feedback, "fraction", 1))
    for name, run in exact.items():
        what = f"{name} where the machine is the model, no noise: error left of that with feedback only"
        rows.append(
            Row(f"exact_{name}", what, run[-1].error_norm / run[0].error_norm, "fraction", 1)
        )
    for key, fit in zip(("fir100", "obf4", "obf12"), example.fits, strict=True):
        what = f"Example 1, {fit.name}: relative L2 error"
        rows.append(Row(f"example1_{key}", what, fit.relative_error, "fraction", 1))
    return tuple(rows)
