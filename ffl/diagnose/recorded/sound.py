"""Is the recording what it says? With a known controller u = f + C_r r - C_y y to print precision, held
to the drive's limit where the plant file states one.

Whatever breaks that equation is a fault of the recording or of the stated controller, never physics:
the plant does not enter it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.recorded.against_controller import (
    INEXACT,
    Fault,
    a_little_late,
    against_controller,
)
from ffl.diagnose.recorded.equation import Equation
from ffl.diagnose.recorded.torn import torn
from ffl.recordings import Recording
from ffl.recordings.jumps import missing_findings
from ffl.systems.plant import Plant

STILL = 1.2  # times the sensor's noise: y that varies less shows nothing else


@dataclass(frozen=True)
class Soundness:
    """`consistency`: RMS of u - f - C_r r + C_y y over that of u, by recording (none in open loop);
    `notes`: what is too little for a fault."""

    consistency: tuple[float, ...]
    faults: tuple[Fault, ...]
    notes: tuple[str, ...] = ()


def soundness(plant: Plant, recordings: Sequence[Recording]) -> Soundness:
    """Checks every recording against the stated controller."""
    ratios, faults = [], []
    notes: dict[int, str] = {}
    if recordings and all(_unmoved(plant, r) for r in recordings):
        faults.append(_at_rest(recordings))
    for recording in recordings:
        fault = _dead(recording) or _incomplete(recording) or torn(plant, recording)
        if fault is None and plant.controller is not None and "u" not in recording.missing:
            eq = Equation(plant, recording)
            ratio, fault = against_controller(plant, recording, eq)
            ratios.append(ratio)
            if fault is None and ratio > INEXACT and (late := a_little_late(eq)):
                samples, told = late
                notes.setdefault(samples, f"{recording.source}: {told}")
        if fault is not None:
            faults.append(fault)
    return Soundness(tuple(ratios), tuple(faults), tuple(notes.values()))


def injected_as_sent(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Recording], list[str]]:
    """Recordings whose f is rescaled where u shows that it acted by up to a quarter more or less.

    u - C_r r + C_y y is f as it really was injected; pulses noted as 5 V that act as 5.07 V leave 3 %
    of u's RMS in the controller's equation, which is an inexact note and not another controller.
    """
    kept, notes = [], []
    for recording in recordings:
        kept.append(recording)
        if plant.controller is None or "u" in recording.missing or not np.any(recording.f):
            continue
        eq = Equation(plant, recording)
        if not np.any(eq.f):
            continue
        fed_back = eq.u - eq.by_r + eq.by_y
        stated, _, _ = eq.left(fed_back - eq.f)
        left, (k,), _ = eq.left(fed_back, [eq.f])
        if stated > 0.002 and left < 0.4 * stated and 0.8 < k < 1.25:
            kept[-1] = replace(recording, f=k * recording.f)
            notes.append(f"{recording.source}: f acted {k:.4g} times as noted; taken as it acted")
    return kept, notes


def _unmoved(plant: Plant, recording: Recording) -> bool:
    """y shows nothing but the noise that is stated of its sensor, from one sample to the next as much as
    over all: what is smooth moved, and the noise is stated too large. (A stage that friction held, at rest
    for 6 s: a hardening spring, explained with 0.87.)"""
    machine, y = plant.machine, recording.y
    noise = float(np.hypot(machine.sensor_noise, machine.encoder_resolution / np.sqrt(12.0)))
    most = 2.0 * noise * (np.sqrt(2.0 * np.log(len(y))) + 1.0)
    white = float(np.std(y)) < float(np.std(np.diff(y)))
    return white and float(np.std(y)) < STILL * noise and float(np.ptp(y)) < most


def _at_rest(recordings: Sequence[Recording]) -> Fault:
    most = max(float(np.abs(r.u[np.isfinite(r.u)]).max(initial=0.0)) for r in recordings)
    return Fault(
        recordings[0].source, "unmoved", "y is the noise of its sensor, and no more",
        f"the machine did not move under commands of up to {most:.3g}: record moves, longer or with more "
        "force",
    )  # fmt: skip


def _dead(recording: Recording) -> Fault | None:
    """Constant signals say nothing."""
    name = recording.source
    if np.ptp(recording.y) == 0:
        return Fault(name, "constant", "y is constant", "record while the machine moves")
    drive = recording.u if np.all(np.isfinite(recording.u)) else recording.r
    if np.ptp(drive) == 0 and np.ptp(recording.r) == 0:
        return Fault(name, "constant", "u and r are constant", "record while the machine is driven")
    return None


def _incomplete(recording: Recording) -> Fault | None:
    """Samples that are missing, their time counted on."""
    for finding in missing_findings(recording):
        where, mend = finding.text.split("; ", 1)
        return Fault(recording.source, finding.kind, where, mend)
    return None
