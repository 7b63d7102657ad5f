"""Finished (or interrupted) runs as read back from their folders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ffl.bases import FreeSignal
from ffl.campaign import Campaign, RunSpec, load_campaign
from ffl.campaign.signals import read_dataset
from ffl.campaign.store import read_results, require_runs
from ffl.errors import InputError
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class FinishedRun:
    """One run of a folder: its entry in results.json, and its signals when asked for."""

    label: str
    folder: Path
    campaign: Campaign
    spec: RunSpec
    entry: dict[str, Any]

    @property
    def path(self) -> Path:
        return self.folder / f"{self.spec.name}.h5"

    @property
    def error_norm(self) -> list[float]:
        return list(self.entry["error_norm"])

    @property
    def trials(self) -> int:
        return len(self.error_norm)

    @property
    def is_free(self) -> bool:
        return isinstance(self.spec.basis, FreeSignal)

    @cached_property
    def theta(self) -> Array:
        """Parameters of every trial, (trials, n)."""
        return read_dataset(self.path, "theta")

    def signal(self, name: str, trial: int = -1) -> Array:
        """f, u, y or e of a trial (1-based, -1: the last)."""
        return read_dataset(self.path, name, trial)

    def response(self, frequencies_hz: Array) -> Array | None:
        """F(theta) of the last trial, None where the basis is not linear and time-invariant."""
        psi = None if self.is_free else self.spec.basis.response(frequencies_hz)
        return None if psi is None else psi @ self.theta[-1]


def same_reference(one: FinishedRun, other: FinishedRun) -> bool:
    """Whether two runs follow one reference."""
    return np.array_equal(one.campaign.reference, other.campaign.reference)


def read_folders(folders: Sequence[Path]) -> list[FinishedRun]:
    """Every run with at least one trial; labelled by run, and by folder where there are several."""
    found: list[FinishedRun] = []
    folders = list(dict.fromkeys(folders))
    short = len({folder.name for folder in folders}) == len(folders)
    for folder in folders:
        results = read_results(folder)
        campaign = load_campaign(folder / "campaign.toml")
        require_runs(folder, results, [run.name for run in campaign.runs])
        for entry in results["runs"]:
            if entry["error_norm"]:
                label = f"{folder.name if short else folder}/{entry['name']}"
                if len(folders) == 1:
                    label = entry["name"]
                found.append(
                    FinishedRun(label, folder, campaign, campaign.run(entry["name"]), entry)
                )
    if not found:
        raise InputError(f"{', '.join(map(str, folders))}: no trial has been completed yet")
    return found


def motion_interval(reference: Array, sample_time: float) -> tuple[float, float]:
    """Times (s) of the first and last sample at which the reference moves."""
    moving = np.flatnonzero(np.diff(reference))
    if not len(moving):
        return 0.0, 0.0
    return float(moving[0] * sample_time), float((moving[-1] + 1) * sample_time)


def cumulative_power(signal: Array, sample_time: float) -> tuple[Array, Array]:
    """(frequencies in Hz, power up to each): ends at sum(signal^2), by Parseval's theorem."""
    n = len(signal)
    power = np.abs(np.fft.rfft(signal)) ** 2 / n
    power[1 : (n + 1) // 2] *= 2.0
    return np.fft.rfftfreq(n, sample_time), np.cumsum(power)


def pre_actuation(feedforward: Array, start: int, threshold: float = 1e-3) -> int:
    """Samples before `start` in which f differs from its first value, what holds the machine at rest, by
    more than `threshold` of the most that it ever does."""
    moved = np.abs(feedforward - feedforward[0])
    early = np.flatnonzero(moved[:start] > threshold * float(moved.max()))
    return int(start - early[0]) if len(early) else 0
