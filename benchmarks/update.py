"""The norm-optimal update beside the same problem written directly in cvxpy.

N = 8000 samples, 18 parameters (both pole sequences repeated once), W_e = 1e5, W_f = 1e-7: the
printer's first update, from matrices to parameters; then with |f| at 80 % of its free peak.
`python benchmarks/update.py [--json] [--cap SECONDS]`
"""

from __future__ import annotations

import argparse
import json
import warnings
from typing import Any

import numpy as np
from _timing import capped, median_seconds

from ffl.bases import OBF
from ffl.campaign.printer2018 import INSIDE, OUTSIDE, STRONG_WEIGHTS, T, reference_signal
from ffl.learn import Constraints, NormOptimal
from ffl.systems import load_plant


def problem() -> tuple[Any, OBF, np.ndarray, np.ndarray, np.ndarray]:
    """Model, basis, reference, and error and command of a trial with feedback only."""
    model, built = load_plant("flatbed_printer"), load_plant("flatbed_printer_built")
    reference = reference_signal()
    n = len(reference)
    rng = np.random.default_rng(0)
    noise = [0.01 * rng.standard_normal(n), 3e-7 * rng.standard_normal(n)]
    y, u = built.loop.system.filter(np.column_stack([reference, np.zeros(n), *noise])).T
    return model, OBF(INSIDE, OUTSIDE, True, 2, T), reference, reference - y, u


def naive(limit: float | None, phi: np.ndarray, response: np.ndarray, error: np.ndarray) -> Any:
    """What a user writes: criterion (3) and the bound on every sample, given to OSQP at 1e-9."""

    def work(started: Any) -> None:
        import cvxpy

        theta = cvxpy.Variable(phi.shape[1])
        cost = 1e5 * cvxpy.sum_squares(error - response @ theta) + 1e-7 * cvxpy.sum_squares(
            phi @ theta
        )
        bounds = [] if limit is None else [cvxpy.abs(phi @ theta) <= limit]
        started.set()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cvxpy.Problem(cvxpy.Minimize(cost), bounds).solve(
                solver=cvxpy.OSQP, eps_abs=1e-9, eps_rel=1e-9, max_iter=1_000_000
            )

    return work


def measure(cap: float) -> dict[str, Any]:
    model, basis, reference, error, command = problem()
    theta = np.zeros(basis.n_parameters)

    def unconstrained() -> Any:
        return NormOptimal(model, basis, reference, STRONG_WEIGHTS).update(theta, error, command)

    ready = NormOptimal(model, basis, reference, STRONG_WEIGHTS)
    free = ready.update(theta, error, command)
    limit = 0.8 * float(np.abs(free.feedforward).max())
    bounds = Constraints(feedforward=limit)

    def constrained() -> Any:
        return NormOptimal(model, basis, reference, STRONG_WEIGHTS, bounds).update(
            theta, error, command
        )

    whole = median_seconds(unconstrained)
    update_only = median_seconds(lambda: ready.update(theta, error, command))
    bounded = median_seconds(constrained)
    solution = constrained()
    other_free, cut_free = capped(naive(None, ready.regressors, ready.response, error), cap)
    other_bound, cut_bound = capped(naive(limit, ready.regressors, ready.response, error), cap)
    return {
        "unconstrained_ratio": other_free / whole,
        "unconstrained_ratio_is_lower_bound": cut_free,
        "constrained_ratio": other_bound / bounded,
        "constrained_ratio_is_lower_bound": cut_bound,
        "unconstrained_seconds": whole,
        "unconstrained_update_alone_seconds": update_only,
        "unconstrained_kkt": free.report.kkt_residual,
        "constrained_seconds": bounded,
        "constrained_kkt": solution.report.kkt_residual,
        "constrained_active": solution.report.active,
        "naive_unconstrained_seconds": other_free,
        "naive_constrained_seconds": other_bound,
        "samples": len(reference),
        "parameters": basis.n_parameters,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--cap", type=float, default=60.0, help="seconds for each naive solve")
    arguments = parser.parse_args()
    result = measure(arguments.cap)
    if arguments.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:38} {value}")


if __name__ == "__main__":
    main()
