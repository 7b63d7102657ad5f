"""Weights in words, and which of them are equal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.learn.weights import Weight
from ffl.report.finished import FinishedRun, same_reference
from ffl.systems import Zpk


def in_words(name: str, weight: Weight) -> str:
    """`name` = 50; or per sample, 0 to 1; or a filter (1 zero, 2 poles)."""
    if isinstance(weight, Zpk):
        zeros, poles = len(weight.zeros), len(weight.poles)
        return f"{name} a filter ({_counted(zeros, 'zero')}, {_counted(poles, 'pole')})"
    values = np.unique(weight)
    if values.size == 1:
        return f"{name} = {values[0]:g}"
    return f"{name} per sample, {values[0]:g} to {values[-1]:g}"


def _counted(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _identity(weight: Weight) -> tuple[object, ...]:
    """The same for equal weights only; a vector of one value is that number."""
    if isinstance(weight, Zpk):
        roots = (tuple(np.sort_complex(part).tolist()) for part in (weight.zeros, weight.poles))
        return (*roots, weight.gain, weight.delay)
    values = np.asarray(weight, float)
    return tuple(np.unique(values)) if np.ptp(values) == 0.0 else (values.tobytes(),)


def equal_error_weights(runs: Sequence[FinishedRun]) -> list[tuple[str, list[int]]]:
    """Runs (their indices) of one reference and equal W_e, each group with a title of its own."""
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, run in enumerate(runs):
        key = (run.campaign.reference.tobytes(), *_identity(run.spec.weights.error))
        groups.setdefault(key, []).append(index)
    told = []
    for members in groups.values():
        run = runs[members[0]]
        other = not same_reference(run, runs[0])
        told.append(in_words("W_e", run.spec.weights.error) + (f", {run.folder.name}" * other))
    return [
        (title if told.count(title) == 1 else f"{title} ({runs[members[0]].label})", members)
        for title, members in zip(told, groups.values(), strict=True)
    ]
