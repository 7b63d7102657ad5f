"""`ffl identify`: inverse systems, or a forward linear model, from recordings, with their page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl.bases import FreeSignal
from ffl.campaign.config import load_step, run_parts
from ffl.campaign.reference import find_map, find_recording
from ffl.errors import InputError
from ffl.identify.inverse import pull_of_output_noise
from ffl.identify.linear.signals import as_signals
from ffl.recordings import Recording, read_recording
from ffl.report.identified import Found, Task, identified_page
from ffl.report.identify_linear import linear
from ffl.report.page import drawing, subplots
from ffl.systems import Plant, load_plant, save_plant
from ffl.systems.atomic import require_own, write_text
from ffl.systems.plant_file import suggest
from ffl.systems.toml_text import inline


def _one(task: Task, method: str) -> Recording:
    if len(task.recordings) > 1:
        raise InputError(f"identify {method} learns from one recording; give --data once")
    return task.recordings[0]


PULLED = 2.0  # standard errors of a bias above which a 95 % band misses the truth


def _fitted(estimator: Any, recording: Recording) -> Any:
    """The estimator, fitted; what it refuses is said with the recording's name."""
    try:
        return estimator.fit(recording)
    except InputError as error:
        text = str(error)
        where = "" if text.startswith(recording.source) else f"{recording.source}: "
        raise InputError(f"{where}{text}") from None


BAND_OF = {
    "kernel": " The band is that of the posterior at the learned hyperparameters: it holds for the taps "
    "that the data see; how small the others are the kernel's decay says, which has an error of its own.",
    "rational": " The band takes the chosen poles and their number for true: the search is not in it. "
    "On 16 realisations of a process whose inverse has one pole, at 1.15, the search added two to four "
    "more, and the band held 41 % of the taps that have one (standard errors 2.5 times too small in the "
    "median); look at `least_squares` beside it.",
}


def _taps(task: Task, method: str, estimator: Any) -> Found:
    from ffl.report import kernel2018_figures as draw

    recording = _one(task, method)
    fitted = _fitted(estimator, recording)
    inverse = fitted.inverse_
    facts = {
        "taps": [
            {"lag": int(k), "value": float(v), "std_error": float(s)}
            for k, v, s in zip(inverse.lags, inverse.theta, inverse.standard_deviation, strict=True)
        ],
        "noise_variance": float(inverse.noise_variance),
        "edges": str(fitted.edges_),
    }
    for name in ("poles_", "outside_"):
        if hasattr(fitted, name):
            facts[name.rstrip("_")] = [[p.real, p.imag] for p in getattr(fitted, name)]
    page = identified_page(method, recording)
    frequencies = np.geomspace(0.5 / len(recording), 0.5, 400) / recording.sample_time
    with drawing():
        figure, axes = subplots(8.6, 5.6, 2, 1)
        inverse.plot(axes[0])
        draw.frequency_response({method: inverse}, frequencies[:-1], axes[1])
    page.section("Inverse").figure(
        figure,
        "Identified inverse with its 95 % band",
        "Taps left of lag zero act before the reference does. Where the band of |F| is wide the "
        f"recording says little: the command had no power there.{BAND_OF.get(method, '')}",
    )
    notes = _unsettled(fitted) + _pulled(recording, inverse)
    return Found(facts, page, notes, basis=_filter(inverse.lags, inverse.theta))


def _unsettled(fitted: Any) -> tuple[str, ...]:
    """What to say where the hyperparameters were learned and the search for them did not end."""
    status = fitted.evidence_.status if hasattr(fitted, "evidence_") else "converged"
    if status == "converged":
        return ()
    return (
        f"the search for the hyperparameters did not converge ({status}): the taps may be smoothed too "
        "much or too little; compare them with those of least_squares, or take fewer taps",
    )


def _pulled(recording: Recording, inverse: Any) -> tuple[str, ...]:
    """What to say where noise of y, which the regression takes for clean, outweighs the stated errors;
    `FED_BACK` says it of a closed loop."""
    pull = pull_of_output_noise(inverse, len(recording))
    if pull < PULLED or _fed_back(recording):
        return ()
    return (
        "y is taken as free of noise: if the residual is noise of y, it biases the taps by up to "
        f"{pull:.2g} of their stated standard errors; `identify bayes` takes the noise to be on y",
    )


def _filter(lags: Any, taps: Any) -> dict[str, Any]:
    """The identified taps as a basis table of a campaign."""
    return {"kind": "filter", "first": int(lags[0]), "taps": [float(tap) for tap in taps]}


def _least_squares(task: Task) -> Found:
    from ffl.identify import LeastSquaresInverse

    return _taps(task, "least_squares", LeastSquaresInverse(task.n_ac, task.n_c))


def _kernel(task: Task) -> Found:
    from ffl.identify import KernelInverse

    return _taps(task, "kernel", KernelInverse(None, task.n_ac, task.n_c))


def _rational(task: Task) -> Found:
    from ffl.identify import RationalInverse

    return _taps(task, "rational", RationalInverse(task.n_ac, task.n_c))


def _bayes(task: Task) -> Found:
    from ffl.identify.bayes import DirectBayesianInverse

    recording = _one(task, "bayes")
    # Its n_c counts the tap of lag 0, as the 2025 paper does; --n-c means the last lag, for all methods.
    fitted = _fitted(DirectBayesianInverse(task.n_ac, task.n_c + 1), recording)
    found = fitted.result_
    rows = zip(fitted.taps_, fitted.theta_, fitted.standard_errors(), strict=True)
    facts = {
        "taps": [{"lag": int(k), "value": float(v), "std_error": float(s)} for k, v, s in rows],
        "noise_variance": float(fitted.noise_variance_),
        "status": str(found.status),
        "effective_sample_size": found.effective_sample_size,
        "importance_effective_sample_size": found.importance_ess,
        "noise_ratio": found.noise_ratio,
        "lack_of_fit_p": found.lack_of_fit,
    }
    page = identified_page("bayes", recording)
    page.section("Posterior").facts(
        [
            ("status", found.status),
            ("effective sample size", finite(found.effective_sample_size)),
            ("noise over that of a free forward model", finite(found.noise_ratio)),
            ("lack of fit, p", finite(found.lack_of_fit)),
        ]
    )
    with drawing():
        figure, ax = subplots()
        fitted.plot(ax)
    page.section("Inverse").figure(
        figure,
        "Taps of the inverse",
        "Posterior mode and two standard deviations either way, over smooth, "
        "independent and alternating taps; taps before zero act before the reference does."
        if found.status == "mode"
        else "Posterior mean and two standard deviations either way; taps before zero act before the "
        "reference does.",
    )
    return Found(facts, page, found.remarks, basis=_filter(fitted.taps_, fitted.theta_))


def _instrumental(task: Task) -> Found:
    from ffl.identify import InstrumentalInverse

    if task.model is None or task.basis is None:
        raise InputError("identify instrumental: give --model (with its controller) and --basis")
    recording = _one(task, "instrumental")
    try:
        basis, _, _ = run_parts(
            load_step(task.basis), task.model.sample_time, task.model, task.basis.parent
        )
        if isinstance(basis, FreeSignal):
            raise InputError("basis kind 'free' has no parameters to identify; take another")
    except InputError as error:
        text = str(error)
        where = "" if text.startswith(str(task.basis)) else f"{task.basis}: "
        raise InputError(f"{where}{text}") from None
    fitted = _fitted(InstrumentalInverse(basis, task.model), recording)
    errors = fitted.inverse_.standard_errors
    facts: dict[str, Any] = {
        "parameters": [
            {"name": name, "value": float(value), "std_error": float(error)}
            for name, value, error in zip(basis.names, fitted.theta_, errors, strict=True)
        ],
        "rank": int(fitted.rank_),
        "instrument_strength": float(fitted.instrument_strength_),
    }
    page = identified_page("instrumental", recording)
    page.section("Inverse").table(
        ["parameter", "value", "standard error"],
        [[p["name"], p["value"], p["std_error"]] for p in facts["parameters"]],
        "Instruments are the model's noise-free answer to r and f, so feedback noise does not bias "
        f"the parameters. Weakest instrument: {facts['instrument_strength']:.3g} (near 0: noise "
        "carries that direction).",
    )
    theta = [float(value) for value in fitted.theta_]
    inner = load_step(task.basis).basis
    return Found(facts, page, basis={"kind": "combination", "basis": inner, "theta": theta})


METHODS: dict[str, Callable[[Task], Found]] = {
    "linear": linear,
    "least_squares": _least_squares,
    "kernel": _kernel,
    "rational": _rational,
    "bayes": _bayes,
    "instrumental": _instrumental,
}


USES = {
    "linear": ("--order", "--model"),
    "instrumental": ("--basis", "--model"),
}  # the others: taps
TAPS, ORDERS = 50, range(1, 9)
BY_REGRESSION = ("least_squares", "kernel", "rational", "bayes")
FED_BACK = (
    "the recording is of a closed loop with little or no f: noise of y reaches u through the "
    "controller, and a regression of u on y then leans towards minus the controller; trust "
    "`identify instrumental` (--model with its controller, --basis), or excite through f"
)


def _fed_back(recording: Recording) -> bool:
    """Whether u is mostly what a controller made of r - y."""
    if np.ptp(recording.r) == 0 or "u" in recording.missing:
        return False
    return float(np.std(recording.f)) < 0.5 * float(np.std(recording.u))


def finite(value: Any) -> Any:
    """`value` without what could not be computed: NaN and infinity are left out of tables."""
    if isinstance(value, Mapping):
        kept = {k: finite(v) for k, v in value.items()}
        return {k: v for k, v in kept.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [v for v in (finite(item) for item in value) if v is not None]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def _at_limits(recordings: Sequence[Recording], plant: Plant | None) -> int:
    """Samples whose output stands at the end of its sensor."""
    signals = as_signals(recordings, None if plant is None else plant.controller)
    return sum(int(np.sum(~s.shown)) for s in signals if s.shown is not None)


def identify_with_report(
    method: str,
    data: Sequence[Path],
    map: Path | None = None,
    model: Path | None = None,
    basis: Path | None = None,
    n_ac: int | None = None,
    n_c: int | None = None,
    orders: Sequence[int] | None = None,
    out: Path | None = None,
) -> dict[str, Any]:
    """Identifies, and writes answer.json, report.html and plant.toml (`linear`) or basis.toml to `out`.
    Taps are `TAPS` to either side, orders `ORDERS` unless given; what `method` does not use is noted."""
    if method not in METHODS:
        raise InputError(f"identify '{method}': {suggest(method, list(METHODS))}")
    given = {"--model": model, "--basis": basis, "--n-ac": n_ac, "--n-c": n_c, "--order": orders}
    idle = [
        option
        for option, value in given.items()
        if value is not None and option not in USES.get(method, ("--n-ac", "--n-c"))
    ]
    n_ac, n_c = TAPS if n_ac is None else n_ac, TAPS if n_c is None else n_c
    if min(n_ac, n_c) < 0:
        raise InputError(f"n_ac = {n_ac}, n_c = {n_c} must not be negative")
    if out is not None:
        require_own(out, "method")
    mapping = find_map(str(map), Path()) if map is not None else None
    plant = load_plant(model) if model is not None else None
    recordings = tuple(
        read_recording(
            find_recording(str(path), Path()),
            mapping,
            sample_time=plant.sample_time if plant is not None else None,
        )
        for path in data
    )
    found = METHODS[method](Task(recordings, plant, basis, n_ac, n_c, tuple(orders or ORDERS)))
    notes = list(found.notes)
    but = {"--model": " but for its sample time: it knows no controller"}
    notes += [f"{method} makes no use of {option}{but.get(option, '')}" for option in idle]
    if method in BY_REGRESSION and _fed_back(recordings[0]):
        notes.append(FED_BACK)
    if method == "linear" and (unseen := _at_limits(recordings, plant)):
        notes.append(f"{unseen} samples at the limit of the sensor were not fitted")
    answer: dict[str, Any] = {"schema": 1, "method": method, **finite(found.facts), "notes": notes}
    if notes:
        found.page.section("To be said with the answer")
    for note in notes:
        found.page.note(note)
    if out is not None:
        write_text(out / "answer.json", json.dumps(answer, indent=1, allow_nan=False) + "\n")
        if found.plant is not None:
            save_plant(found.plant, out / "plant.toml")
        if found.basis is not None:  # a line for a campaign's [[runs]], and what `ffl step` reads
            line = f"basis = {inline([found.basis])}"
            weights = "weights = { error = 1.0, feedforward = 1e-12 }"
            write_text(out / "basis.toml", f"{line}\n{weights}\n")
        found.page.write(out / "report.html")
    return answer
