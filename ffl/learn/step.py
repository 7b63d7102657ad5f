"""One learning step on a real machine's recording, which may begin with the machine in motion."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases import Basis
from ffl.errors import InputError
from ffl.learn.along_trajectory import AlongTrajectory
from ffl.learn.constraints import Constraints
from ffl.learn.coordinates import orthonormal
from ffl.learn.foretold import led_in
from ffl.learn.norm_optimal import NormOptimal, UpdateReport
from ffl.learn.standard_errors import standard_errors
from ffl.learn.weights import Weights, apply_weight, is_zero
from ffl.machines import is_linear
from ffl.recordings import Recording
from ffl.systems import Plant
from ffl.systems.state_space import Array

FED_BACK = 1e-3  # of the command's peak, u - f above which is no resolution of a measured command
INJECTED = 0.01  # share of |f| that rounding in a file does not leave: something else was injected
NEARLY = (
    2.0  # times what no parameters give: an injection lies across the basis rather than along it
)
BEGINNING, REST = 5, 1e-3  # samples of a beginning, and of the largest speed what is none
STILL = 3.0  # standard errors that a parameter may move in a step while learning has settled


@dataclass(frozen=True)
class Step:
    """What one step learned from a recording of N samples.

    theta: next parameters (n,); feedforward: next f (N,), input units; previous: the parameters
    that the recording was made with. error: r - y as recorded; start: what of it decays from the
    unknown state of the first sample; predicted: r - y expected with the next feedforward, from
    rest. std_error: what noise leaves open of theta, from the residual's spectrum, the response taken
    from the model as it is; what the model's response itself is off is not in it. servo: what the
    controller itself does for the reference, (C_r - C_y) r in the basis, so that theta + servo is the
    force on the plant (zero where the controller acts on r - y).
    """

    names: tuple[str, ...]
    theta: Array
    previous: Array
    feedforward: Array
    error: Array
    start: Array
    predicted: Array
    std_error: Array
    servo: Array
    report: UpdateReport
    sample_time: float
    notes: tuple[str, ...] = field(default=())


def learn_from_recording(
    model: Plant,
    basis: Basis,
    recording: Recording,
    weights: Weights,
    constraints: Constraints | None = None,
    previous: ArrayLike | None = None,
    path: str = "auto",
) -> Step:
    """theta minimising criterion (3) for the next trial of the recorded reference.

    The error is written e = e_0 - SP (Phi theta_j + d) - O x_0: `previous` is theta_j (None: zero),
    d whatever else the recorded f holds (a known injection) and the recording's known load, O x_0 the
    response to the state x_0 in which the closed loop was when the recording began. x_0 is estimated
    together with theta by QR and its part taken out, so a recording cut out of a running motion
    teaches without bias.
    It is one step of learning, with the model's SP: where machine and model differ, theta is off by
    that difference times what the step has to correct, many standard errors in a first step. A
    carriage of 90 kg with 300 N s/m, learned with the EMPS model, is off by 2 % of the mass and by
    0.1 % after the second step; one of 5 kg with 40 N s/m, learned with a model without damping, by
    11 % (4.455 +- 0.029 kg) and 0.4 %. That the recording cannot tell: the part of SP's error that
    lies along the basis leaves no residual. A note says so until a step moves no parameter by more
    than `STILL` standard errors.
    Of a model with effects the step is that of `AlongTrajectory` (`path` "auto"), where the reference
    begins at rest: what state friction and the like are in when a recording begins in motion, x_0 does
    not say, and there the step is the linear one.
    Raises `InputError` where the recording and the model do not fit. Cost O(N (n + n_x)^2).
    """
    _check(model, recording)
    t = model.sample_time
    updater = NormOptimal(model, _GoingOn(basis), recording.r, weights, constraints, path)
    phi, response = updater.regressors, updater.response
    theta = np.zeros(basis.n_parameters) if previous is None else np.asarray(previous, float)
    if theta.shape != (basis.n_parameters,):
        raise InputError(
            f"state: theta has {theta.size} values, the basis {basis.n_parameters} parameters; give "
            "the state of the same basis"
        )
    sp = updater.loop.process_sensitivity
    injection = recording.f - phi @ theta
    notes = []
    if np.linalg.norm(injection) > 1e-6 * max(float(np.linalg.norm(recording.f)), 1e-300):
        notes.append(
            "the recorded f holds more than the basis with the last parameters: the rest is taken "
            "as a known injection of that trial, which the next one does not repeat; where the trial "
            "ran without the feedforward of the step before, leave --state out"
        )
    error = recording.r - recording.y
    if recording.d is not None and np.any(recording.d):
        notes.append("the known load d is that trial's own: the next one is predicted without it")
    # What the nominal loop alone would leave for this reference belongs to e_0: it stays in.
    known = recording.f if recording.d is None else recording.f + recording.d
    target = error + sp.filter(known)
    free = sp.free_response(len(error))
    start, joint = _joint(response, free, phi, target, weights)
    command = recording.f if model.controller is None else recording.u
    try:
        if path == "auto" and not is_linear(model) and _from_rest(recording.r):
            lead = led_in(recording.r)
            along = AlongTrajectory(model, _GoingOn(basis), recording.r, weights, constraints, lead)
            update = along.update(theta, error, command, recording.f, recording.d)
            predicted = along.predicted(theta, error, update.theta, recording.f, recording.d)
        else:
            update = updater.update(theta, target - start - response @ theta, command)
            predicted = target - start - response @ update.theta
    except InputError as refused:
        raise InputError(f"{recording.source}: {refused}") from None
    servo = orthonormal(joint)
    own = apply_weight(weights.error, sp.filter(_servo(model, recording.r)))
    said = standard_errors(joint, apply_weight(weights.error, predicted), updater.loop)
    notes += _still_moving(basis.names, update.theta - theta, said)
    notes += list(recording.notes)
    return Step(
        tuple(basis.names),
        update.theta,
        theta,
        update.feedforward,
        error,
        start,
        predicted,
        said,
        servo.theta(servo.coordinates(own)),
        update.report,
        t,
        tuple(notes),
    )


def _still_moving(names: list[str], moved: Array, std_error: Array) -> list[str]:
    """A note where the step had more to correct than noise."""
    told = std_error > 0.0  # of a direction that no data see there is no error
    share = np.where(told, np.abs(moved) / np.where(told, std_error, 1.0), 0.0)
    most = int(np.argmax(share))
    if share[most] <= STILL:
        return []
    return [
        f"the standard errors are those of noise alone: this step moved {names[most]} by "
        f"{moved[most]:.4g}, {share[most]:.3g} of them, and where the model's response is off, by "
        "10 % say, so is that move; repeat the step on the next trial until it moves no parameter by "
        f"more than {STILL:g} standard errors"
    ]


def feedforward_for(basis: Basis, recording: Recording, theta: Array, previous: Array) -> Array:
    """The next f (N,) for this recording's reference: the basis with `theta`, and what its f held
    beside the basis (see `beside`) once more."""
    return beside(basis, recording, previous) + _GoingOn(basis).regressors(recording.r) @ theta


def beside(basis: Basis, recording: Recording, previous: Array) -> Array:
    """What the recorded f (N,) holds beside the basis, (N,): an injection, or a part of an earlier,
    richer basis that this one does not represent.

    Which parameters a recording that taught nothing ran with, nobody says. f less its projection on the
    basis is what no parameters give. Where `previous` or none at all leave at most `NEARLY` times as
    much, it ran with those, and all the rest is an injection, its part along the basis too: a signal
    for identification must come back whole. Else it ran with other parameters, and only what no
    parameters give is kept; so is f of an earlier basis, of which this one represents the most. Where
    that is less than `INJECTED` of f, it is rounding in a file.
    """
    phi = _GoingOn(basis).regressors(recording.r)
    q = orthonormal(phi).q
    left = recording.f - q @ (q.T @ recording.f)
    size = float(np.linalg.norm(left))
    if size <= INJECTED * np.linalg.norm(recording.f):
        return left
    known = (recording.f - phi @ previous, np.array(recording.f))
    nearest = min(known, key=lambda rest: float(np.linalg.norm(rest)))
    return nearest if np.linalg.norm(nearest) <= NEARLY * size else left


class _GoingOn(Basis):
    """`basis` for a recording cut out of a motion: beyond its samples the reference goes on at the
    velocity it has there. Holding it, as for a trial at rest, would ask for an infinite force."""

    REACH = 2000  # samples

    def __init__(self, basis: Basis) -> None:
        self.basis = basis

    @property
    def names(self) -> list[str]:
        return self.basis.names

    def regressors(self, reference: ArrayLike) -> Array:
        r = np.asarray(reference, float)
        steps = np.arange(1.0, self.REACH + 1)
        before = r[0] - (r[1] - r[0]) * steps[::-1]
        after = r[-1] + (r[-1] - r[-2]) * steps
        whole = self.basis.regressors(np.concatenate([before, r, after]))
        return whole[self.REACH : self.REACH + len(r)]


def _check(model: Plant, recording: Recording) -> None:
    if abs(recording.sample_time / model.sample_time - 1.0) > 1e-3:
        raise InputError(
            f"{recording.source}: sample time {recording.sample_time:g} s, model '{model.name}' has "
            f"{model.sample_time:g} s; resample one of them"
        )
    if "r" in recording.missing or not np.any(np.diff(recording.r)):
        raise InputError(
            f"{recording.source}: the reference r is missing or constant; a step learns from a motion"
        )
    for name in ("r", "f", "y", "d"):
        values = getattr(recording, name)
        if values is not None and not np.all(np.isfinite(values)):
            at = int(np.argmin(np.isfinite(values)))
            raise InputError(f"{recording.source}: column {name}, row {at + 1} is not a number")
    fed_back = float(np.abs(np.nan_to_num(recording.u - recording.f)).max())
    if model.controller is None and fed_back > FED_BACK * float(
        np.abs(np.nan_to_num(recording.u)).max()
    ):
        raise InputError(
            f"{recording.source}: the command u is not the feedforward f, so a controller was at work, "
            f"and model '{model.name}' has no [controller]: the step would take the loop for open; "
            "write the controller into the model"
        )


def _joint(
    response: Array, free: Array, phi: Array, target: Array, weights: Weights
) -> tuple[Array, Array]:
    """The start's part of the error (N,), and the weighted columns of theta with the start's taken
    out, which carry the information on theta."""
    columns = apply_weight(weights.error, response)
    b = apply_weight(weights.error, target)
    basis = orthonormal(apply_weight(weights.error, free))
    clean = columns - basis.q @ (basis.q.T @ columns)
    rows, right = [clean], [b - basis.q @ (basis.q.T @ b)]
    if not is_zero(weights.feedforward):
        rows.append(apply_weight(weights.feedforward, phi))
        right.append(np.zeros(len(phi)))
    joint = orthonormal(np.vstack(rows))
    theta = joint.theta(joint.coordinates(np.concatenate(right)))
    state = basis.theta(basis.coordinates(b - columns @ theta))
    return free @ state, clean


def _from_rest(reference: Array) -> bool:
    """Whether the reference stands still at first."""
    moved = np.abs(np.diff(reference))
    return bool(moved[:BEGINNING].max(initial=0.0) <= REST * moved.max(initial=0.0))


def _servo(model: Plant, reference: Array) -> Array:
    """(C_r - C_y) r: the command that the controller gives while y = r."""
    if model.controller is None or model.controller.one_degree:
        return np.zeros(len(reference))
    moved = reference - reference[0]
    return model.controller.state_space.filter(np.column_stack([moved, moved]))
