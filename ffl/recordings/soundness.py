"""Can this recording be trusted? The first step of a diagnosis: findings, never exceptions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.recordings.command_findings import command_findings
from ffl.recordings.finding import Finding
from ffl.recordings.jumps import missing_findings
from ffl.recordings.recording import COLUMNS, Recording
from ffl.recordings.repeats import repeat_findings
from ffl.recordings.sampling import accepts, examine_time
from ffl.recordings.sensor_findings import constant_findings, sensor_findings
from ffl.recordings.spikes import spike_findings

FEW = 200
"""Samples below which a recording is said to be short."""


@dataclass(frozen=True)
class Soundness:
    """What was found in one recording, the gravest first.

    `sound` is False where a finding is a fault: something that would be taken for physics.
    """

    source: str
    samples: int
    sample_time: float
    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        return not self.faults

    @property
    def faults(self) -> tuple[Finding, ...]:
        return tuple(x for x in self.findings if x.severity == "fault")

    def of(self, kind: str) -> tuple[Finding, ...]:
        """The findings of one kind."""
        return tuple(x for x in self.findings if x.kind == kind)


def soundness(recording: Recording, sample_time: float | None = None) -> Soundness:
    """Everything in a recording that is not what the machine did.

    Looked for: short; not finite; backwards, repeated, gap and jitter in time; a sample time other
    than `sample_time` [s]; constant columns; clipped and frozen output, and its spikes; blocks written
    twice; saturated
    command; the encoder's step; command against feedforward, output against reference (unit, sign).
    Faults need two signs that a healthy machine does not give together: a machine at rest under a
    coarse encoder is not frozen, a hold at the end of a stroke is not clipping, and neither is
    sticking.
    """
    found: list[Finding] = []
    n = len(recording)
    if n < FEW:
        found.append(
            Finding(
                "short",
                "recording",
                f"{n} samples: too few to tell effects apart; record at least {FEW}",
                "warning",
                value=float(n),
            )
        )
    measured = {
        name: values
        for name in COLUMNS
        if (values := getattr(recording, name)) is not None and name not in recording.missing
    }
    broken = {name: np.flatnonzero(~np.isfinite(x)) for name, x in measured.items()}
    for name, rows in broken.items():
        if len(rows):
            found.append(
                Finding(
                    "not_finite",
                    name,
                    f"{len(rows)} values of {name} are not finite, the first at sample {rows[0]}",
                    "fault",
                )
            )
    if not found or not any(x.kind == "not_finite" for x in found):
        found += _timing(recording, sample_time)
        found += constant_findings(recording)
        found += sensor_findings(recording)
        found += spike_findings(recording)
        found += repeat_findings(recording)
        found += missing_findings(recording)
        found += command_findings(recording)
    order = {"fault": 0, "warning": 1, "note": 2}
    found.sort(key=lambda x: order[x.severity])
    return Soundness(recording.source, n, recording.sample_time, tuple(found))


def _timing(recording: Recording, sample_time: float | None) -> list[Finding]:
    found = []
    measured = "t" not in recording.missing and len(recording) > 2
    sampling = examine_time(recording.t) if measured else None
    faults, gaps = (sampling.faults, sampling.gaps) if sampling else ((), ())
    for fault in faults:
        t = recording.t
        spans = [(fault.row - 1, fault.row)]
        if fault.kind == "gap":
            spans = [(row - 1, row) for row, _ in gaps]
        found.append(
            Finding(
                fault.kind,
                "t",
                f"{fault.text}; {fault.mend}",
                "fault",
                tuple((float(t[a]), float(t[b])) for a, b in spans),
            )
        )
    actual = sampling.sample_time if sampling else recording.sample_time
    if sample_time is not None and not accepts(actual, sample_time):
        found.append(
            Finding(
                "sample_time",
                "t",
                f"the sample time is {actual:.6g} s, the model's is {sample_time:.6g} s; resample "
                "the recording or correct its time column",
                "fault",
                value=actual,
            )
        )
    return found
