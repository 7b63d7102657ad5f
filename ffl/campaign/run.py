"""Runs a campaign into a folder, trial by trial, and goes on where it was interrupted."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ffl.campaign.config import Campaign, check_campaign
from ffl.campaign.signals import (
    add_second,
    append_trial,
    last_trial,
    read_dataset,
    read_reports,
    read_second,
)
from ffl.campaign.store import Store, versions
from ffl.campaign.trials import CarriedOver, Event, Stopped
from ffl.campaign.workers import Job, events
from ffl.errors import InputError
from ffl.learn import Trial, UpdateReport

Progress = Callable[[str, int, float], None]


@dataclass(frozen=True)
class Outcome:
    """Where the run lies and what could not be completed (run name, reason)."""

    folder: Path
    results: dict[str, Any]
    stopped: tuple[tuple[str, str], ...] = ()


def run_campaign(
    campaign: Campaign,
    folder: Path,
    jobs: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
) -> Outcome:
    """Runs every run of the campaign; `progress(run, trial, error_norm)` after each stored trial.

    Each trial is complete on disk before the next of its run begins. The numbers are the same for
    any `jobs`, and for a run resumed after a kill.
    """
    if jobs < 1:
        raise InputError(f"jobs = {jobs} must be at least 1")
    check_campaign(campaign)
    store = Store.open(folder, campaign.resolved, resume)
    stopped: dict[str, Stopped] = {}
    try:
        waiting: list[Job] = []
        for run in campaign.runs:
            after = last_trial(store.signals(run.name), campaign.sample_time)
            last = after is not None and after.number >= campaign.trials
            done = last and read_second(store.signals(run.name)) is not None
            waiting.append((run.name, after, done))
            if after is not None and progress is not None:
                progress(run.name, after.number, after.error_norm)
        with closing(events(campaign, waiting, jobs)) as stream:
            for name, event in stream:
                _store(campaign, store.signals(name), name, event)
                if isinstance(event, Stopped):
                    stopped[name] = event
                elif isinstance(event, Trial) and progress is not None:
                    progress(name, event.number, event.error_norm)
    finally:  # what is complete is said, also where the work ends early
        try:
            results = collect(campaign, store, stopped)
            store.write_results(results)
        finally:
            store.close()
    return Outcome(folder, results, tuple((name, s.message) for name, s in stopped.items()))


def _store(campaign: Campaign, path: Path, name: str, event: Event) -> None:
    if isinstance(event, Trial):
        units = {"y": campaign.machine.output_unit, "u": campaign.machine.input_unit}
        append_trial(path, event, campaign.reference, units, campaign.run(name).basis.names)
    elif isinstance(event, CarriedOver) and campaign.second_reference is not None:
        add_second(path, campaign.second_reference, event.recording, event.feedback_only)


def collect(campaign: Campaign, store: Store, stopped: dict[str, Stopped]) -> dict[str, Any]:
    """`results.json` from what is on disk."""
    runs = []
    for run in campaign.runs:
        path = store.signals(run.name)
        entry: dict[str, Any] = {"name": run.name, "parameters": campaign.parameters(run)}
        norms = read_dataset(path, "error_norm").tolist() if path.exists() else []
        halted = stopped.get(run.name)
        complete = len(norms) >= campaign.trials
        entry["status"] = halted.status if halted else "done" if complete else "running"
        if halted:
            entry["message"] = halted.message
        entry["error_norm"] = norms
        entry |= {
            name: read_dataset(path, name).tolist() if path.exists() else []
            for name in ("feedforward_norm", "cost")
        }
        entry["update"] = [_report(r) for r in (read_reports(path) if path.exists() else [])]
        second = read_second(path) if path.exists() else None
        if second is not None:
            entry["second_reference"] = {
                "error_norm": float(np.linalg.norm(second["e"])),
                "error_norm_feedback_only": float(np.linalg.norm(second["e_feedback_only"])),
            }
        runs.append(entry)
    return {
        "schema": 1,
        "campaign": campaign.name,
        "seed": campaign.seed,
        "runs": runs,
        "trials": campaign.trials,
        "sample_time": campaign.sample_time,
        "samples": len(campaign.reference),
        "units": {"input": campaign.machine.input_unit, "output": campaign.machine.output_unit},
        "model": campaign.model.name,
        "machine": campaign.machine.name,
        "versions": versions(),
    }


def _report(report: UpdateReport) -> dict[str, Any]:
    """An update as results.json states it; a figure that could not be computed is absent."""
    entry: dict[str, Any] = {"seconds": report.seconds, "status": report.status}
    if np.isfinite(report.kkt_residual):
        entry["kkt_residual"] = report.kkt_residual
    entry |= {"rank": report.rank, "active": report.active}
    if np.isfinite(report.left_out):
        entry["left_out"] = report.left_out
    if report.message:
        entry["message"] = report.message
    return entry
