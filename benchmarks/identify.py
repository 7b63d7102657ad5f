"""Seconds and fit of every identification method on the same data, beside the printed form and a
public package.

1. the 2018 loop, N = 1000, 601 taps, noise as large as the signal: seconds and paired excess of the
   tracking error over the perfect inverse (least squares about 0.5); equation (7) as printed;
2. causal TC kernel, 80 taps: `impulseest` from the Python package index, where it is installed;
3. records of 1e3 to 1e5 samples: seconds, exponent, memory;
4. the 2025 system, N = 60: the direct Bayesian estimator and what that paper compares it with;
5. the flatbed printer: one closed-loop trial against ten trials of learning.

`python benchmarks/identify.py [--json] [--realisations N]`
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from _timing import median_seconds
from numpy.random import SeedSequence, default_rng

import ffl.identify.kernel2018 as paper
from ffl.bases import OBF as Basis
from ffl.identify import (
    Edges,
    InstrumentalInverse,
    KernelInverse,
    RationalInverse,
    backward_regression,
    least_squares,
)
from ffl.identify.bayes import DirectBayesianInverse, inverse_fit, naive, paper_data, two_step
from ffl.identify.evidence import regularised
from ffl.identify.kernels import DC, TC, Direct
from ffl.learn import LearningTask, Weights, learn
from ffl.machines import SimulatedMachine
from ffl.systems import Move, load_plant, moves

KNOWN = Edges("known", "known")
TAPS = paper.TAPS


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def on_the_2018_loop(realisations: int) -> dict[str, Any]:
    """Seconds per record and mean paired excess, every method on the same records."""
    kernel = paper.kernels()["noncausal_kernel"]
    near = Direct(-2, 0, 1e4)

    def given(rows: Any) -> np.ndarray:
        return regularised(rows, kernel.factor(rows.lags), 1.0).theta

    def tuned(start: Any) -> Callable[[Any], np.ndarray]:
        def work(rows: Any) -> np.ndarray:
            model = KernelInverse(start, TAPS, TAPS, KNOWN)
            return model.fit(rows.output, rows.target, lead=TAPS).inverse_.theta

        return work

    def searched(rows: Any) -> np.ndarray:
        model = RationalInverse(TAPS, TAPS, 3, edges=KNOWN)
        return model.fit(rows.output, rows.target, lead=TAPS).inverse_.theta

    methods: dict[str, Callable[[Any], np.ndarray]] = {
        "least_squares": least_squares,
        "obf_kernel_given_poles": given,
        "obf_kernel_learned_poles": lambda rows: paper.learned_poles(rows).theta,
        "rational_from_nothing": searched,
        "tc_two_sided_and_direct": tuned(TC(1e-2, 0.98, 0.98) + near),
        "dc_two_sided_and_direct": tuned(DC(1e-2, 0.98, 0.98, correlation=0.99) + near),
    }
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    excess: dict[str, list[float]] = {name: [] for name in methods}
    paper.learned_poles(paper.draw(SeedSequence(0)).regression)  # compile
    for seed in SeedSequence(99).spawn(realisations):
        perfect = None
        for name, method in methods.items():
            task = paper.draw(seed)  # fresh: no method inherits another's triangle
            taken, theta = timed(lambda m=method, t=task: m(t.regression))
            perfect = float(np.linalg.norm(task.noise) / np.sqrt(paper.N))
            seconds[name].append(taken)
            excess[name].append(paper.tracking_error(theta, task) - perfect)
    rows = paper.draw(SeedSequence(99)).regression
    phi = rows.matrix()

    def printed() -> np.ndarray:
        d = kernel.matrix(rows.lags)
        return np.linalg.solve(d @ phi.T @ phi + np.eye(len(d)), d @ phi.T @ rows.target)

    ours, theirs = given(rows), printed()
    dense = median_seconds(printed, 3)
    return {
        "low_rank_ratio": dense / median_seconds(lambda: given(rows), 11),
        "low_rank_agreement": float(np.abs(ours - theirs).max() / np.abs(ours).max()),
        "printed_7_seconds": dense,
        "seconds": {name: float(np.median(values)) for name, values in seconds.items()},
        "excess": {name: float(np.mean(values)) for name, values in excess.items()},
        "realisations": realisations,
    }


def beside_impulseest() -> dict[str, Any]:
    """Forward impulse response of the loop, 80 causal taps, TC kernel, both on the same record."""
    n, taps = 1000, 80
    rng = default_rng(5)
    r = rng.standard_normal(n)
    clean = paper.system().filter(r)
    y = clean + 0.1 * clean.std() * rng.standard_normal(n)
    truth = paper.system().impulse_response(taps)

    def fit(g: np.ndarray) -> float:
        return float(100 * (1 - np.linalg.norm(g - truth) / np.linalg.norm(truth - truth.mean())))

    def ours() -> np.ndarray:
        kernel = TC(1e-3, 0.9, side="causal")
        model = KernelInverse(kernel, 0, taps - 1, Edges("zero", "drop"))
        return model.fit(r, y).inverse_.theta

    seconds, found = median_seconds(ours, 3), ours()
    answer: dict[str, Any] = {"ours_seconds": seconds, "ours_fit": fit(found)}
    if importlib.util.find_spec("impulseest") is None:
        return {**answer, "impulseest": "not installed: pip install impulseest"}
    from impulseest import impulseest

    def theirs() -> np.ndarray:
        return np.asarray(impulseest(r, y, taps, "TC")).ravel()

    try:
        other, result = timed(theirs)
    except (np.linalg.LinAlgError, ValueError) as error:
        return {**answer, "impulseest": f"failed: {error}"}
    return {**answer, "impulseest_ratio": other / seconds, "impulseest_fit": fit(result)}


def long_records() -> dict[str, Any]:
    """Learned poles at N = 1e3, 1e4, 1e5: no N x N matrix, so time and memory grow with N."""
    sizes, seconds = (1_000, 10_000, 100_000), []
    state_space = paper.system().state_space()
    for n in sizes:
        rng = default_rng(n)
        r = rng.standard_normal(n)
        y = state_space.filter(np.pad(r, TAPS))
        target = r + rng.standard_normal(n)

        def work(y: np.ndarray = y, target: np.ndarray = target) -> Any:
            rows = backward_regression(y, target, TAPS, TAPS, KNOWN, lead=TAPS)
            return paper.learned_poles(rows)

        work()
        taken, found = timed(work)
        seconds.append(taken)
    least, _ = timed(
        lambda: least_squares(backward_regression(y, target, TAPS, TAPS, KNOWN, lead=TAPS))
    )
    error = np.linalg.norm(found.theta - paper.true_taps()) / np.linalg.norm(paper.true_taps())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "samples": sizes,
        "seconds": seconds,
        "exponent": float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0]),
        "least_squares_601_taps_seconds_1e5": least,
        "relative_error_1e5": float(error),
        "process_peak_mib": peak,
    }


def on_the_2025_system(n_sets: int = 10) -> dict[str, Any]:
    """Fit (25) in % and seconds of the methods of the 2025 paper, data sets 1000 on."""
    fits: dict[str, list[float]] = {"naive": [], "two_step": [], "direct_bayesian": []}
    seconds: dict[str, list[float]] = {name: [] for name in fits}

    def direct(u: np.ndarray, y: np.ndarray) -> np.ndarray:
        return DirectBayesianInverse(n_ac=4, n_c=2).fit(u, y, rng=default_rng(1)).theta_

    methods: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
        "naive": lambda u, y: naive(u, y, 4, 2).theta,
        "two_step": lambda u, y: two_step(u, y, 4, 2).theta,
        "direct_bayesian": direct,
    }
    direct(paper_data(0).u[:60], paper_data(0).y)  # compile
    for seed in range(1000, 1000 + n_sets):
        data = paper_data(seed)
        for name, method in methods.items():
            taken, theta = timed(lambda m=method, d=data: m(d.u[: d.n_samples], d.y))
            seconds[name].append(taken)
            fits[name].append(inverse_fit(theta, 4, data.u, data.x, data.n_samples))
    return {
        "median_fit": {name: float(np.median(values)) for name, values in fits.items()},
        "seconds": {name: float(np.median(values)) for name, values in seconds.items()},
        "data_sets": n_sets,
    }


def on_the_printer() -> dict[str, Any]:
    """||e||_2 in m: feedback only; the inverse from that one trial; two and ten trials of learning."""
    model, machine = load_plant("flatbed_printer"), load_plant("flatbed_printer_built")
    printer = SimulatedMachine(machine)
    stops = ((1.5, 0.3), (3.5, -0.3), (5.5, 0.3))
    reference = moves([Move(s, d, 0.6, 3.0, 60.0) for s, d in stops], 8.0, 1e-3)
    zeros = model.system.zeros
    basis = Basis(zeros[abs(zeros) < 1], zeros[abs(zeros) > 1], True, sample_time=1e-3)
    first = printer.run(reference, None, default_rng(1))
    answer: dict[str, Any] = {"feedback_only": float(np.linalg.norm(reference - first.y))}
    for method in ("least_squares", "instrumental"):
        seconds, found = timed(lambda m=method: InstrumentalInverse(basis, model, m).fit(first))
        second = printer.run(reference, found.predict(reference), default_rng(2))
        answer[f"{method}_second_trial"] = float(np.linalg.norm(reference - second.y))
        answer[f"{method}_seconds"] = seconds
    task = LearningTask(model, printer, basis, reference, Weights(50.0, 1e-7, 0.0))
    learned = [trial.error_norm for trial in learn(task, 10, SeedSequence(1))]
    return {**answer, "learning_second_trial": learned[1], "learning_tenth_trial": learned[9]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--realisations", type=int, default=5)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    result = {
        "kernel2018": on_the_2018_loop(arguments.realisations),
        "causal_tc": beside_impulseest(),
        "long_records": long_records(),
        "bayes2025": on_the_2025_system(),
        "printer": on_the_printer(),
    }
    if arguments.json:
        print(json.dumps(result))
        return
    for part, values in result.items():
        print(part)
        for name, value in values.items():
            print(f"  {name:36} {value}")


if __name__ == "__main__":
    main()
