"""Faults of the command: saturated; at odds with the feedforward, or the output with the reference."""

from __future__ import annotations

import numpy as np

from ffl.recordings.finding import Array, Finding, equal_runs, spans
from ffl.recordings.recording import Recording


def command_findings(recording: Recording) -> list[Finding]:
    if "u" in recording.missing or np.ptp(recording.u) == 0:
        return []
    return [*_saturated(recording), *_feedforward(recording), *_tracking(recording)]


def _saturated(recording: Recording) -> list[Finding]:
    """A command with many values that returns exactly to its extremes, and stays.

    Only in closed loop: an open-loop command is what somebody chose, plateaus and all.
    """
    u = recording.u
    if recording.is_open_loop or ("f" not in recording.missing and np.array_equal(u, recording.f)):
        return []
    first, stop = equal_runs(u, 3)
    extreme = np.isin(u[first], [u.min(), u.max()])
    first, stop = first[extreme], stop[extreme]
    count = int((stop - first).sum())
    if count < max(10, 1e-3 * len(u)):
        return []
    rest = u[(u != u.min()) & (u != u.max())]
    share = count / len(u)
    # Steps and pulses have few values; a feedback command hardly ever repeats one.
    if len(np.unique(rest)) < min(100, 0.5 * len(rest)):
        return []
    levels = np.unique(u[first])
    # At rest a noise-free command stands still at an extreme too, but it comes there gently.
    if not _abrupt(u, first):
        return []
    said = " and ".join(f"{level:.6g}" for level in levels)
    return [
        Finding(
            "saturated",
            "u",
            f"u stands at its extreme {said} for {100 * share:.2g} % of the samples: the actuator's "
            "limit, beyond which u does not follow the controller (`command_limit` in [machine])",
            "fault" if share > 0.5 else "warning",
            spans(recording.t, first, stop),
            share,
        )
    ]


def _abrupt(u: Array, first: Array) -> bool:
    """True where the slope into the stretches is not a small fraction of the usual slope."""
    slopes = np.abs(np.diff(u))
    moving = slopes[slopes > 0]
    entered = first[first >= 2]
    if len(moving) == 0 or len(entered) == 0:
        return len(entered) == 0
    into = np.abs(u[entered - 1] - u[entered - 2])
    return bool(np.median(into) > 0.2 * np.median(moving))


def _feedforward(recording: Recording) -> list[Finding]:
    """Whether u = u_fb + f holds: the part of f that the controller cannot give must be in u.

    Without the controller, u_fb is stood for by r and y at lags 0 to 3, their sums and a constant.
    Where that together with f leaves little of u (1 %), the factor on f must be 1; it is told only
    where what f has of its own fixes the factor, and the factor is far from 1.
    """
    u, f = recording.u, recording.f
    if "f" in recording.missing or np.ptp(f) == 0:
        return []
    if recording.is_open_loop:
        factor = float(u @ f / (f @ f))
        close = np.linalg.norm(u - factor * f) < 0.01 * np.linalg.norm(u)
        return _factor_finding(factor, "u", "u is {0:.4g} f") if close else []
    n = min(len(u), 100_000)
    columns = [np.ones(n)]
    for x in (recording.r[:n], recording.y[:n]):
        columns += [np.concatenate([np.full(k, x[0]), x[: n - k]]) for k in range(4)]
    columns.append(np.cumsum(recording.error[:n]))
    rest = np.column_stack(columns)
    rest = rest / np.maximum(np.linalg.norm(rest, axis=0), 1e-300)
    basis, singular, _ = np.linalg.svd(rest, full_matrices=False)
    basis = basis[:, singular > 1e-9 * singular[0]]
    own_f = f[:n] - basis @ (basis.T @ f[:n])
    own_u = u[:n] - basis @ (basis.T @ u[:n])
    power = float(own_f @ own_f)
    if power < 1e-8 * np.var(f[:n]) * n:
        return []
    factor = float(own_u @ own_f) / power
    left = np.linalg.norm(own_u - factor * own_f)
    # The second bound leaves the factor within 5 % even if all that is left were its error.
    if left > 0.01 * np.std(u[:n]) * np.sqrt(n) or left > 0.05 * max(abs(factor), 1) * power**0.5:
        return []
    return _factor_finding(factor, "f", "{0:.4g} f is in the command u, not f itself")


def _tracking(recording: Recording) -> list[Finding]:
    """y follows r in a working loop: a factor far from 1 between them is a unit or a sign."""
    r, y = recording.r, recording.y
    if recording.is_open_loop or np.ptp(r) == 0:
        return []
    a, b = r - r.mean(), y - y.mean()
    power = float(a @ a) * float(b @ b)
    if power == 0 or abs(a @ b) / np.sqrt(power) < 0.98:
        return []
    return _factor_finding(float(a @ b) / float(a @ a), "y", "y follows {0:.4g} r")


def _factor_finding(factor: float, where: str, text: str) -> list[Finding]:
    said = text.format(factor)
    if -3 < factor < -1 / 3:
        what = "one of them has the wrong sign"
        return [Finding("sign", where, f"{said}: {what}", "fault", value=factor)]
    if abs(factor) > 20 or abs(factor) < 0.05:
        what = "one of them is in another unit" if abs(factor) > 1e-5 else "one does not act"
        return [Finding("unit", where, f"{said}: {what}", "fault", value=factor)]
    return []
