"""The transmission between two encoders: what a motor's and a load's position differ by, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.recorded.glitches import without_turns
from ffl.diagnose.recorded.trials import commanded
from ffl.diagnose.transmission.encoders import Pair, Smoother, comparable, cut_off, pair
from ffl.diagnose.transmission.result import Transmission, told
from ffl.diagnose.transmission.search import search
from ffl.diagnose.transmission.terms import Known, Scene, Term, with_motion
from ffl.effects import is_speed
from ffl.recordings import Recording
from ffl.recordings.units import factor_between
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

FORETOLD = 0.5  # share of the motion that reference or command must foretell
LAGS = 8  # shifted accelerations of the reference that foretell the motion
SPAN = 2.0  # widths of the kernel between them
STEPS = 5


def transmission(
    model: Plant, recordings: Sequence[Recording], validation: Sequence[Recording] = ()
) -> Transmission | None:
    """Explains y - y_load by delay, scale, torsion, play and ripple; None without a second encoder.

    `validation` recordings with a second encoder judge, if they hold what the others do; otherwise each
    tenth of the recordings, by what the other nine say. Angles are carried on over a turn. Raises
    `InputError` where the encoders cannot be compared.
    """
    if is_speed(model.output_unit):
        return None
    pairs, judging = (_with_two(model, _ready(model, group)) for group in (recordings, validation))
    if not pairs:
        return None
    cut = cut_off([_drive(model, r) for r in pairs], pairs)
    smoother = Smoother.at(cut, model.sample_time)
    scene, notes = _scene(model, pairs, smoother)
    if scene is None:
        return None
    found = search(scene)
    if found is None:
        return None
    judge = _judging(model, judging, smoother, scene)
    if judge is not None and (lacking := _lacking(scene.known, judge.known)):
        notes.append(
            f"the validation recordings hold no {lacking}, which this was fitted with: judged by tenths "
            "of the others"
        )
        judge = None
    return told(model, found.scene, found, judge, cut, notes)


def _ready(model: Plant, recordings: Sequence[Recording]) -> list[Recording]:
    """Angles carried on over a turn; u as the controller gave it, where that is known and u is not."""
    carried_on, _ = without_turns(model, recordings)
    return [commanded(model, r) if model.controller is not None else r for r in carried_on]


def _with_two(model: Plant, recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings whose two encoders can be compared."""
    given = [r for r in recordings if r.y_load is not None]
    return comparable(given, [_drive(model, r) for r in given])


def _known(model: Plant, pairs: Sequence[Recording]) -> tuple[Known, list[str]]:
    p = model.physics
    notes = []
    load = p.load_mass
    if load is None and p.mass is not None and p.motor_constant is not None:
        load = p.mass
        notes.append(
            "the mass behind the transmission is not stated ([physics] load_mass): all of it is taken to "
            "be there, and the stiffness falls with its share"
        )
    motor = 0.0 if load is None or p.mass is None else max(p.mass - load, 0.0)
    size = factor_between(model.output_unit, "m") or factor_between(model.output_unit, "rad") or 1.0
    load, motor = None if load is None else size * load, size * motor  # N s^2 per unit of y
    has_load = all(r.d is not None and np.ptp(r.d) > 0 for r in pairs)
    has_command = all(np.all(np.isfinite(r.u)) and np.ptp(r.u) > 0 for r in pairs)
    return Known(load, motor, has_load, has_command, True), notes


def _lacking(fitted: Known, judging: Known) -> str:
    """What `fitted` recordings hold and `judging` ones do not; empty: nothing."""
    held = (
        ("known load d", fitted.has_load and not judging.has_load),
        ("command u", fitted.has_command and not judging.has_command),
    )
    return " and ".join(name for name, lacks in held if lacks)


def _drive(model: Plant, r: Recording) -> Array:
    """What moves the machine and no sensor has seen: the reference, or the model's answer to u."""
    if not r.is_open_loop and np.ptp(r.r) > 0:
        return np.asarray(r.r)
    u = r.u if r.d is None else r.u + r.d
    return (
        np.asarray(model.system.filter(u - np.mean(u[:1]))) if np.all(np.isfinite(u)) else r.t * 0
    )


def _scene(
    model: Plant, recordings: Sequence[Recording], smoother: Smoother, shift: float | None = None
) -> tuple[Scene | None, list[str]]:
    """The recordings smoothed, the second encoder's shift found (or as given)."""
    known, notes = _known(model, recordings)
    force = model.physics.motor_constant or 1.0
    lag = LAGS * SPAN * smoother.width
    margin = smoother.margin(lag)
    if min(len(r) for r in recordings) < 2 * margin + 40 * smoother.every:
        return None, notes
    drives = [_foretelling(smoother, _drive(model, r), margin) for r in recordings]

    def at(shift: float) -> tuple[tuple[Pair, ...], float, float]:
        made = [pair(r, smoother, shift, margin, force) for r in recordings]
        return with_motion(made, drives)

    plain, position, acceleration = at(0.0)
    if max(position, acceleration) < FORETOLD:
        return None, notes
    known = replace(known, moved=acceleration > FORETOLD)
    terms = [Term("delay")]
    if known.moved and (known.load_mass is not None or known.has_load):
        terms.append(Term("torsion", "load"))
    scene = Scene(plain, plain, 0.0, known, 0, np.zeros(0))
    for _ in range(STEPS if shift is None else 0):
        fit = scene.fit(terms)  # in white noise: only the shift is wanted
        if fit is None:
            break
        step = fit.value("delay")[0]
        new = float(np.clip(scene.shift + step, -lag, lag))
        scene = replace(scene, shifted=at(new)[0], shift=new)
        if abs(step) < 1e-4 * model.sample_time:
            break
    if shift is not None:
        scene = replace(scene, shifted=at(shift)[0], shift=shift)
    if not known.moved:
        notes.append(
            "neither reference nor command foretells how the machine moves: no torque is known, so nothing "
            "is said of the spring"
        )
    return scene.beside(()), notes


def _foretelling(smoother: Smoother, drive: Array, margin: int) -> Array:
    """Position, speed and accelerations at several lags of what drives the motion, and a constant."""
    lags = [-SPAN * k * smoother.width for k in range(LAGS)]
    columns = [smoother(drive, 0, 0.0, margin), smoother(drive, 1, 0.0, margin)]
    columns += [smoother(drive, 2, lag, margin) for lag in lags]
    table = np.column_stack([np.ones(len(columns[0])), *columns])
    return table


def _judging(
    model: Plant, recordings: Sequence[Recording], smoother: Smoother, scene: Scene
) -> Scene | None:
    if not recordings:
        return None
    return _scene(model, recordings, smoother, scene.shift)[0]
