"""The 2018 kernel paper, reproduced: Example 6, the estimates of Figure 4, the errors of Figure 5.

Source: Blanken, van den Meijdenberg and Oomen 2018, sections 3 and 6, with what the print needs:

- the plant has relative degree 2, so its inverse has three large taps k = -2, -1, 0 (41.6, -72.1,
  33.0; no other above 0.19) that the five printed functions cannot carry: three poles of (8) at the
  origin (`direct` = 3) and a kernel scale far above one are added; `as_printed` shows why;
- xi_u of section 6 lies outside the disc and is reflected, as (8) wants;
- r is zero outside its N samples, y is known beyond them (simulated), and the feedforward acts over
  its whole preview: the only reading under which the perfect inverse is perfect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from joblib import Parallel, delayed, parallel_config
from numpy.random import SeedSequence, default_rng
from numpy.typing import NDArray

from ffl.errors import InputError
from ffl.identify.evidence import maximise_evidence
from ffl.identify.inverse import IdentifiedInverse
from ffl.identify.kernels import OBF, Direct, Fixed, Kernel
from ffl.identify.regression import Edges, Regression, backward_regression, least_squares
from ffl.identify.row import Row
from ffl.systems import StateSpace, Zpk, load_plant, two_sided_filter, two_sided_impulse

Array = NDArray[np.float64]
Progress = Callable[[float, str], None]

N = 1000  # samples of the reference
TAPS = 300  # n_ac = n_c
NOISE = 1.0  # variances of v_r and of v_y
STABLE = (0.985 + 0.1j, 0.985 - 0.1j, 0.985)  # xi_s, section 6
OUTSIDE = (1.003 + 0.2j, 1.003 - 0.2j)  # xi_u, section 6, where the poles really lie
DIRECT = 3  # relative degree 2, and k = 0
SCALE = 1e4
POLE_SPREAD = 0.5  # hyperprior of the learned poles: damping and stiffness within a factor 1.65
REALISATIONS, FAST_REALISATIONS = 1000, 100
CHUNK = 10

METHODS = {
    "perfect": "perfect inverse",
    "least_squares": "least squares (3)",
    "causal_kernel": "causal kernel, anti-causal taps free",
    "noncausal_kernel": "non-causal OBF kernel with direct terms",
    "data_driven_poles": "the same, poles and variances by marginal likelihood",
    "as_printed": "non-causal OBF kernel as printed: no direct terms, scale 1",
}


@dataclass(frozen=True)
class Example6:
    """Figure 3 on the samples `t`: reference, both feedforward signals, both outputs."""

    t: NDArray[np.int64]
    reference: Array
    noncausal: Array
    causal: Array
    noncausal_output: Array
    causal_output: Array


@dataclass(frozen=True)
class Kernel2018:
    """Everything `ffl reproduce kernel2018` measured.

    `errors` (n_realisations, n_methods) holds ||e||/sqrt(N), columns in the order of `methods`.
    `estimates` are the inverses of the first realisation (Figure 4), `true_taps` the exact ones.
    `coverage` is the share of true taps within the 95 % band of the data-driven estimate.
    """

    rows: tuple[Row, ...]
    methods: tuple[str, ...]
    errors: Array
    estimates: dict[str, IdentifiedInverse]
    true_taps: Array
    example6: Example6
    coverage: float
    seed: int

    def as_dict(self) -> dict[str, object]:
        return {"schema": 1, "paper": "kernel2018", "rows": [row.as_dict() for row in self.rows]}


@lru_cache(maxsize=1)
def system() -> Zpk:
    """P = G C/(1 + G C) of section 6: zeros are those of G and C, poles the loop's eigenvalues."""
    plant = load_plant("kernel2018_loop")
    controller = plant.controller
    if controller is None or not isinstance(plant.system, Zpk):
        raise InputError("plants/kernel2018_loop.toml must be a zpk plant with a [controller]")
    g, c = plant.system, controller.output
    if not isinstance(c, Zpk):
        raise InputError("plants/kernel2018_loop.toml: give the [controller] in zpk form")
    zeros = np.concatenate([g.zeros, c.zeros])
    return Zpk(zeros, plant.loop.poles, g.gain * c.gain, plant.sample_time)


@lru_cache(maxsize=1)
def _state_space() -> StateSpace:
    return system().state_space()


def example6(before: int = 10, after: int = 10) -> Example6:
    """P = (z - 2)/z, r(t) = 0.5^t: the bounded two-sided feedforward and the unbounded causal one."""
    plant = Zpk([2.0], [0.0], 1.0, 1.0)
    t = np.arange(-before, after + 1)
    settled = 60  # samples until 0.5^t has left the last digit of a double
    reference = 0.5 ** np.arange(after + settled + 1.0)
    inverse = plant.inverse()
    noncausal = two_sided_filter(inverse, reference, before)[: len(t)]
    causal = np.concatenate([np.zeros(before), inverse.filter(reference)[: after + 1]])
    started = two_sided_filter(inverse, reference, before + 1)[: len(t) + 1]
    return Example6(
        t,
        np.concatenate([np.zeros(before), reference[: after + 1]]),
        noncausal,
        causal,
        plant.filter(started)[1:],
        plant.filter(causal),
    )


@dataclass(frozen=True)
class Realisation:
    """Data of one realisation: the regression of task 1, reference and output noise of task 2."""

    regression: Regression
    reference: Array
    noise: Array


def draw(seed: SeedSequence) -> Realisation:
    """One realisation; every task has its own draw from the realisation's own seed."""
    rng = default_rng(seed)
    r = rng.standard_normal(N)
    y = _state_space().filter(np.pad(r, TAPS))
    target = r + np.sqrt(NOISE) * rng.standard_normal(N)
    regression = backward_regression(y, target, TAPS, TAPS, Edges("known", "known"), lead=TAPS)
    return Realisation(regression, rng.standard_normal(N), np.sqrt(NOISE) * rng.standard_normal(N))


def tracking_error(theta: Array, task: Realisation) -> float:
    """||e||_2/sqrt(N) of the second task: feedforward over the whole preview, e on 1..N."""
    feedforward = np.convolve(task.reference, theta)
    output = _state_space().filter(feedforward[: TAPS + N])[TAPS:] + task.noise
    return float(np.linalg.norm(task.reference - output) / np.sqrt(N))


def kernels() -> dict[str, Kernel]:
    """The kernels compared, by method."""
    return {
        "causal_kernel": OBF.of_poles(STABLE, scale=SCALE) + Direct(-TAPS, 0),
        "noncausal_kernel": OBF.of_poles(STABLE, OUTSIDE, direct=DIRECT, scale=SCALE),
        "as_printed": OBF.of_poles(STABLE, OUTSIDE, scale=1.0),
    }


def learned_poles(regression: Regression) -> IdentifiedInverse:
    """Poles, scale and noise variance by marginal likelihood, from section 6's poles as expectation."""
    start = OBF.of_poles(STABLE, OUTSIDE, direct=DIRECT, scale=SCALE, pole_spread=POLE_SPREAD)
    return maximise_evidence(regression, regression.lags, start, NOISE).inverse(
        regression, system().sample_time
    )


def estimate(regression: Regression) -> dict[str, IdentifiedInverse]:
    """All estimates of one realisation."""
    triangle, sample_time = regression.triangle, system().sample_time
    theta = least_squares(regression)
    found = {
        "least_squares": IdentifiedInverse(theta, TAPS, TAPS, sample_time, NOISE, triangle.r),
        "data_driven_poles": learned_poles(regression),
    }
    for name, kernel in kernels().items():
        rows = triangle if name == "causal_kernel" else regression
        given = maximise_evidence(rows, regression.lags, Fixed(kernel), NOISE, learn_noise=False)
        found[name] = given.inverse(regression, sample_time)
    return found


def _chunk(seeds: list[SeedSequence]) -> list[tuple[list[float], float]]:
    """Errors per method, and coverage of the 95 % band, of some realisations."""
    truth = true_taps()
    results = []
    for seed in seeds:
        task = draw(seed)
        found = estimate(task.regression)
        errors = [float(np.linalg.norm(task.noise) / np.sqrt(N))]
        errors += [tracking_error(found[name].theta, task) for name in METHODS if name in found]
        band = found["data_driven_poles"].impulse_band(0.95)
        inside = (truth >= band.lower) & (truth <= band.upper)
        results.append((errors, float(np.mean(inside))))
    return results


def true_taps() -> Array:
    """theta^o_k of (4), k = -300 .. 300."""
    return two_sided_impulse(system().inverse(), TAPS, TAPS)


def reproduce(
    fast: bool = False, jobs: int = 1, progress: Progress | None = None, seed: int = 2018
) -> Kernel2018:
    """Figures 3, 4 and 5 and their numbers: 1000 realisations, 100 where `fast`.

    Every realisation has its own seed, so the numbers do not depend on the number of workers.
    Workers use one BLAS thread each: more only cost time on matrices of this size.
    """
    if jobs < 1:
        raise InputError(f"jobs = {jobs} must be 1 or more")
    n = FAST_REALISATIONS if fast else REALISATIONS
    seeds = SeedSequence(seed).spawn(n)
    chunks = [seeds[i : i + CHUNK] for i in range(0, n, CHUNK)]
    measured: list[tuple[list[float], float]] = []
    with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
        work = Parallel(return_as="generator")(delayed(_chunk)(chunk) for chunk in chunks)
        for i, part in enumerate(work):
            measured += part
            if progress:
                progress((i + 1) / len(chunks), f"{len(measured)} of {n} realisations")
    errors = np.array([row for row, _ in measured])
    return Kernel2018(
        _rows(errors),
        tuple(METHODS),
        errors,
        estimate(draw(seeds[0]).regression),
        true_taps(),
        example6(),
        float(np.mean([c for _, c in measured])),
        seed,
    )


def _rows(errors: Array) -> tuple[Row, ...]:
    n = len(errors)
    rows = []
    for values, (key, what) in zip(errors.T, METHODS.items(), strict=True):
        paper = 1.0 if key == "perfect" else None
        error = float(values.std(ddof=1) / np.sqrt(n))
        rows.append(
            Row(key, f"mean ||e||/sqrt(N), {what}", float(values.mean()), "1", n, error, paper)
        )
    for values, (key, what) in zip(errors.T[1:], list(METHODS.items())[1:], strict=True):
        excess = values - errors[:, 0]
        error = float(excess.std(ddof=1) / np.sqrt(n))
        rows.append(
            Row(f"{key}_excess", f"paired excess, {what}", float(excess.mean()), "1", n, error)
        )
    return tuple(rows)
