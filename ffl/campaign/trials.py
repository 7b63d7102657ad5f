"""The trials of one run, one by one, wherever they are computed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.random import SeedSequence

from ffl.bases import FreeSignal
from ffl.campaign.config import Campaign
from ffl.errors import WorkError
from ffl.learn import Trial, learn, trial_rng
from ffl.recordings import Recording


@dataclass(frozen=True)
class CarriedOver:
    """The second reference: with the learned parameters, and with feedback alone."""

    recording: Recording
    feedback_only: Recording


@dataclass(frozen=True)
class Stopped:
    """A run that could not go on: `status` is "infeasible" or "diverged"."""

    status: str
    message: str


Event = Trial | CarriedOver | Stopped


def run_trials(
    campaign: Campaign, name: str, after: Trial | None, carried_over: bool = False
) -> Iterator[Event]:
    """Trials after `after`, then the second reference unless it is `carried_over` already.

    The numbers depend on the campaign, the run's name and the trial's number alone.
    """
    run = campaign.run(name)
    task, seed = campaign.task(run), campaign.seed_of(run)
    last = after
    if (stopped := _stopped(last)) is not None:
        yield stopped
        return
    try:
        for trial in learn(task, campaign.trials, seed, after):
            yield trial
            last = trial
            if (stopped := _stopped(trial)) is not None:
                yield stopped
                return
    except WorkError as error:  # the simulated machine diverged
        yield Stopped("diverged", str(error))
        return
    second = campaign.second_reference
    if last is None or second is None or carried_over or isinstance(run.basis, FreeSignal):
        return
    feedforward = run.basis.regressors(second) @ last.theta
    seed = SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 2**31))
    yield CarriedOver(
        task.machine.run(second, feedforward, trial_rng(seed, 1)),
        task.machine.run(second, np.zeros(len(second)), trial_rng(seed, 2)),
    )


def _stopped(trial: Trial | None) -> Stopped | None:
    if trial is not None and trial.update is not None and trial.update.status == "infeasible":
        return Stopped("infeasible", f"trial {trial.number}: {trial.update.message}")
    return None
