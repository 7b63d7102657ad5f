"""`ffl step`: one learning step on a real recording, its files and its page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl import __version__
from ffl.bases import Basis, FreeSignal
from ffl.campaign.config import load_step, run_parts
from ffl.campaign.reference import find_map, find_recording
from ffl.campaign.state import read_state, write_state
from ffl.errors import InputError
from ffl.learn.foretold import Foretold, foretold
from ffl.learn.step import INJECTED, Step, beside, feedforward_for, learn_from_recording
from ffl.recordings import Recording, read_recording
from ffl.report.finished import motion_interval
from ffl.report.learning_figures import over_time
from ffl.report.page import Page, drawing, subplots
from ffl.systems import Plant, load_plant
from ffl.systems.atomic import require_own, write_text
from ffl.systems.state_space import Array

UNTOLD = 1e3  # times a parameter: a standard error beyond says nothing of it


def step_with_report(
    model_path: Path,
    basis_path: Path,
    trial: Path,
    out: Path,
    map: Path | None,
    state: Path | None,
    checks: Sequence[Path] = (),
    check_map: Path | None = None,
) -> dict[str, Any]:
    """Learns one step and writes feedforward.csv, state.json, answer.json and report.html to `out`.

    Where the model has effects, it foretells the error with the next feedforward, on the trial and
    on the recordings `checks`, from which nothing is learned. Everything is read, learned and
    checked before the first file is written.
    """
    model = load_plant(model_path)
    form = load_step(basis_path)
    try:
        model.require_stable()
    except InputError as error:
        raise InputError(f"{model_path}: {error}") from None
    try:
        basis, weights, constraints = run_parts(form, model.sample_time, model, basis_path.parent)
        if isinstance(basis, FreeSignal):
            raise InputError("basis kind 'free' has no parameters to learn in a step; take another")
        if form.update == "closed_form" and constraints.any:
            raise InputError("update = 'closed_form' has no bounds; use 'auto' or 'osqp'")
        unknown = sorted(set(form.documented) - set(basis.names))
        if unknown:
            known = ", ".join(basis.names)
            raise InputError(
                f"documented.{unknown[0]}: not a parameter of the basis; known: {known}"
            )
    except InputError as error:
        raise InputError(f"{basis_path}: {error}") from None
    mapping = find_map(str(map), Path()) if map is not None else None
    recording = read_recording(find_recording(str(trial), Path()), mapping)
    number, previous = 0, None
    if state is not None:
        number, previous = read_state(state, basis.names, form.basis, model)
    try:
        step = learn_from_recording(
            model, basis, recording, weights, constraints, previous, form.update
        )
    except InputError as error:
        text = str(error)
        where = "" if text.startswith(recording.source) else f"{basis_path}: "
        raise InputError(f"{where}{text}") from None
    _require_sound(model, recording)
    if step.report.status == "infeasible":
        raise InputError(f"{basis_path}: constraints: {step.report.message}")
    answer = _answer(step, form.documented, number + 1)
    others = [
        read_recording(
            find_recording(str(path), Path()),
            find_map(str(check_map), Path()) if check_map is not None else mapping,
        )
        for path in checks
    ]
    told: list[Foretold] = []
    if model.effects or others:
        told = [
            foretold(model, r, feedforward_for(basis, r, step.theta, step.previous))
            for r in (recording, *others)
        ]
        answer["notes"] += _beside(basis, others, step.previous)
        answer["foretold"] = [{"recording": t.recording, **t.rms} for t in told]
    page = step_page(step, recording, model, answer, told)
    require_own(out, "predicted_error_norm")
    write_text(out / "feedforward.csv", _csv(recording.t, recording.r, step.feedforward))
    write_text(out / "answer.json", json.dumps(answer, indent=1, allow_nan=False) + "\n")
    page.write(out / "report.html")
    write_state(out / "state.json", number + 1, step, form.basis, model, recording.source)
    return answer


def _beside(basis: Basis, checks: Sequence[Recording], previous: Array) -> list[str]:
    """A note on every check whose f holds more than the basis gives."""
    shares = [
        (r.source, np.linalg.norm(beside(basis, r, previous)), np.linalg.norm(r.f)) for r in checks
    ]
    return [
        f"{source}: {rest / whole:.2g} of the norm of its f is not of the basis (an injection, or an "
        "earlier basis): its error is foretold with that part kept beside the new parameters"
        for source, rest, whole in shares
        if rest > INJECTED * whole
    ]


def _require_sound(model: Plant, recording: Recording) -> None:
    """A wrong unit, sign or controller would be learned as feedforward; it is refused instead."""
    from ffl.diagnose.recorded.sound import soundness

    for fault in soundness(model, [recording]).faults:
        raise InputError(f"{fault.recording}: {fault.where}: {fault.mend}")


def _csv(time: Array, reference: Array, feedforward: Array) -> str:
    rows = zip(time, reference, feedforward, strict=True)
    return "t,r,f\n" + "".join(f"{float(a)!r},{float(b)!r},{float(c)!r}\n" for a, b, c in rows)


def _answer(step: Step, documented: dict[str, float], trial: int) -> dict[str, Any]:
    on_plant = step.theta + step.servo
    parameters = [
        {"name": name, "value": float(value), "std_error": float(error), "on_plant": float(total)}
        for name, value, error, total in zip(
            step.names, step.theta, step.std_error, on_plant, strict=True
        )
    ]
    answer: dict[str, Any] = {
        "schema": 1,
        "trial": trial,
        "parameters": parameters,
        "error_norm": float(np.linalg.norm(step.error)),
        "predicted_error_norm": float(np.linalg.norm(step.predicted)),
        "update": {
            "seconds": step.report.seconds,
            "status": step.report.status,
            "kkt_residual": step.report.kkt_residual,
            "rank": step.report.rank,
        }
        | ({"left_out": step.report.left_out} if np.isfinite(step.report.left_out) else {}),
        "notes": list(step.notes),
    }
    learned = dict(zip(step.names, on_plant.tolist(), strict=True))
    if documented:
        answer["documented"] = {
            name: {"documented": value, "learned": learned[name]}
            | ({"relative": learned[name] / value - 1.0} if value else {})
            for name, value in documented.items()
        }
    return answer


def relative(entry: Mapping[str, float]) -> str:
    """How far a learned parameter is from what is documented; of nothing there is no share."""
    return f"{entry['relative']:+.1%}" if "relative" in entry else "-"


def error_told(entry: Mapping[str, float]) -> float | str:
    """The standard error of a parameter; where this trial says nothing of it, or nothing that another
    parameter does not take back, that."""
    error, size = entry["std_error"], abs(entry["value"])
    return error if error > 0.0 and (error < UNTOLD * size or not size) else "not told"


def step_page(
    step: Step,
    recording: Recording,
    model: Plant,
    answer: dict[str, Any],
    told: Sequence[Foretold] = (),
) -> Page:
    """What was learned, from what, and what to expect of the next trial."""
    unit_y, unit_f = model.output_unit or "-", model.input_unit or "-"
    page = Page(
        f"Learning step {answer['trial']}: {model.name}",
        f"From {recording.source}: {len(recording)} samples of {step.sample_time * 1e3:g} ms.",
    )
    n = np.sqrt(len(recording))
    ahead = f"predicted next error, RMS [{unit_y}]", answer["predicted_error_norm"] / n
    if told and model.effects:  # the prediction beside is that of the linear part
        ahead = f"next error foretold with effects, RMS [{unit_y}]", told[0].rms["after"]
    page.section("What was learned").facts(
        [
            (f"recorded error, RMS [{unit_y}]", answer["error_norm"] / n),
            ahead,
            ("KKT residual of the update", step.report.kkt_residual),
            ("directions used, of the parameters", f"{step.report.rank} of {len(step.names)}"),
        ]
    )
    servo = bool(np.any(step.servo))
    header = ["parameter", "feedforward θ", "standard error (noise alone)"]
    header += ["θ + servo's own term: force on the plant"] if servo else []
    page.table(
        header,
        [
            [p["name"], p["value"], error_told(p), *([p["on_plant"]] if servo else [])]
            for p in answer["parameters"]
        ],
        "One norm-optimal step, from a state of the loop that is estimated with it. Standard errors "
        "follow from the residual's spectrum"
        + (
            ". The servo treats reference and output differently, so that it does something of its "
            "own for a reference that is followed perfectly; feedforward first cancels that, and "
            "what stays is the force the plant needs."
            if servo
            else "."
        ),
    )
    if "documented" in answer:
        page.heading("Beside what is documented")
        page.table(
            ["parameter", "documented", "learned", "learned / documented − 1"],
            [
                [name, entry["documented"], entry["learned"], relative(entry)]
                for name, entry in answer["documented"].items()
            ],
            "Documented values stand in the basis file; the learned ones come from this one trial.",
        )
    for note in answer["notes"]:
        page.note(note)
    if told:
        _foretold(page, told, unit_y, bool(model.effects))
    _figures(page, step, recording, unit_y, unit_f, bool(model.effects))
    return page


def _foretold(page: Page, told: Sequence[Foretold], unit: str, effects: bool) -> None:
    title = "Foretold by the model with its effects" if effects else "Foretold by the model"
    page.section(title).table(
        ["recording", "measured", "model, as recorded", "model, with the next feedforward"],
        [[t.recording, *t.rms.values()] for t in told],
        f"RMS of r - y [{unit}]. Where the first two agree, the third is worth believing; recordings "
        "after the first taught nothing.",
    )
    with drawing():
        figure, axes = subplots(8.6, 2.6 * len(told), len(told), 1, squeeze=False)
        for ax, t in zip(axes[:, 0], told, strict=True):
            for name in ("measured", "before", "after"):
                ax.plot(getattr(t, name), label=name, lw=1.0)
            ax.set(xlabel="sample", ylabel=f"r - y [{unit}]", title=t.recording)
        axes[0, 0].legend(ncols=3, loc="upper right")
        page.figure(
            figure,
            "Error measured, and on the model before and after",
            "What feedforward of the reference cannot foresee (known pulses, noise) stays.",
        )


def _figures(
    page: Page, step: Step, recording: Recording, unit_y: str, unit_f: str, effects: bool
) -> None:
    time = recording.t
    marks = motion_interval(recording.r, step.sample_time)
    with drawing():
        figure, axes = subplots(8.6, 5.8, 3, 1, sharex=True)
        over_time(axes[0], time, [("", recording.r)], f"reference [{unit_y}]")
        over_time(axes[1], time, [("", step.error), ("", step.predicted)], f"error [{unit_y}]")
        axes[1].legend(
            axes[1].get_lines(),
            ["recorded", "predicted for the next trial"],
            ncols=2,
            loc="lower right",
            bbox_to_anchor=(1.0, 0.97),
        )
        over_time(axes[2], time, [("", step.feedforward)], f"next feedforward [{unit_f}]")
        for ax in axes[:2]:
            ax.set_xlabel("")
        page.section("Signals").figure(
            figure,
            "Reference, error and next feedforward",
            f"The motion of the recording runs from {marks[0]:g} to {marks[1]:g} s. The predicted "
            "error is what the model cannot explain of the recorded one: noise, and physics that "
            "neither the model nor the basis holds.",
        )
        figure, ax = subplots(8.6, 3.0)
        over_time(ax, time, [("", step.predicted)], f"predicted error [{unit_y}]")
        page.figure(
            figure,
            "What this step leaves",
            "The predicted error alone"
            + (", of the model's linear part" if effects else "")
            + ". Structure that returns with the motion marks what a further "
            "basis function, or a diagnosis of the recording (ffl diagnose), could still take away.",
        )
    page.footer = f"Written by ffl {__version__}."
