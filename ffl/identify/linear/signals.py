"""The signals a linear fit sees: checked, cut into pieces, brought to comparable size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffl.errors import InputError
from ffl.identify.regression import upper_triangle
from ffl.systems import Controller
from ffl.systems.state_space import Array

RUN = 8  # samples at one value in a row: a sensor at its limit
MOVES = 0.01  # of the drive's range: what it must move meanwhile


@dataclass(frozen=True)
class Signals:
    """One recording as arrays of one length N: input `u`, output `y`, `sample_time` in seconds.

    `r` reference, `f` feedforward, `d` known load in the input's unit; None where not recorded.
    `shown`: False where y stands at the limit of its sensor (None: nowhere); such samples are run
    through but not fitted.
    """

    u: Array
    y: Array
    sample_time: float
    r: Array | None = None
    f: Array | None = None
    d: Array | None = None
    source: str = "signals"
    shown: Array | None = None

    def __post_init__(self) -> None:
        for name in ("u", "y", "r", "f", "d"):
            value = getattr(self, name)
            if value is None:
                if name in ("u", "y"):
                    raise InputError(f"{self.source}: no column {name}; a linear fit needs u and y")
                continue
            array = np.ascontiguousarray(value, dtype=float)
            if array.ndim != 1:
                raise InputError(
                    f"{self.source}: {name} has shape {array.shape}; give one value per sample"
                )
            if array.shape != np.shape(self.u):
                raise InputError(
                    f"{self.source}: {name} has {array.size} samples, u has {np.size(self.u)}; "
                    "give columns of equal length"
                )
            bad = np.flatnonzero(~np.isfinite(array))
            if bad.size:
                raise InputError(
                    f"{self.source}: {name}[{bad[0]}] is NaN or infinite ({bad.size} in all); "
                    "cut the recording there or repair it"
                )
            object.__setattr__(self, name, array)
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise InputError(f"{self.source}: sample_time = {self.sample_time}; give seconds > 0")

    def __len__(self) -> int:
        return self.y.size

    def cut(self, start: int, stop: int) -> Signals:
        """The samples start .. stop-1."""

        def part(x: Array | None) -> Array | None:
            return None if x is None else x[start:stop]

        return replace(
            self,
            u=self.u[start:stop],
            y=self.y[start:stop],
            r=part(self.r),
            f=part(self.f),
            d=part(self.d),
            shown=part(self.shown),
        )

    @property
    def force(self) -> Array:
        """What drives the plant: command plus known load."""
        return self.u if self.d is None else self.u + self.d


def as_signals(recordings: Any, controller: Controller | None = None) -> tuple[Signals, ...]:
    """One `Recording` or `Signals`, or a sequence of them, checked; sample times within 0.1 %.

    A command that was not recorded is computed from r, f and y where the controller is known.
    """
    if hasattr(recordings, "y"):
        recordings = [recordings]
    if not isinstance(recordings, Sequence) or not recordings:
        raise InputError("no recording given; give at least one with u and y")
    pieces = tuple(
        r if isinstance(r, Signals) else _from_recording(r, controller) for r in recordings
    )
    for piece in pieces[1:]:
        if abs(piece.sample_time / pieces[0].sample_time - 1.0) > 1e-3:
            raise InputError(
                f"{piece.source}: sample_time {piece.sample_time:g} s differs from "
                f"{pieces[0].sample_time:g} s of {pieces[0].source}; resample one"
            )
    return pieces


def _from_recording(recording: Any, controller: Controller | None) -> Signals:
    for name in ("u", "y", "sample_time"):
        if not hasattr(recording, name):
            raise InputError(
                f"{type(recording).__name__} has no {name}; give a Recording, or Signals(u, y, "
                "sample_time)"
            )
    missing: frozenset[str] = getattr(recording, "missing", frozenset())

    def column(name: str) -> Array | None:
        return None if name in missing else getattr(recording, name, None)

    source = str(getattr(recording, "source", "recording")) or "recording"
    u = recording.u
    if "u" in missing and not np.all(np.isfinite(u)):
        if controller is None:
            raise InputError(
                f"{source}: the command u is not recorded; give the controller it follows from"
            )
        u = recording.f + controller.state_space.filter(np.column_stack([recording.r, recording.y]))
    return Signals(
        u,
        recording.y,
        float(recording.sample_time),
        column("r"),
        column("f"),
        column("d"),
        source,
        None if column("r") is not None else _below_limits(np.asarray(recording.y), np.asarray(u)),
    )


def _below_limits(y: Array, u: Array) -> Array | None:
    """False where y is at its largest or smallest value, to the last digit, where it stands there for
    `RUN` samples or more while u moves; None where it never does. A limit bends any linear model."""
    shown = np.ones(len(y), bool)
    for limit in (y.max(), y.min()):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (y == limit).astype(int), [0]])))
        stays = zip(edges[::2], edges[1::2], strict=True)
        if any(b - a >= RUN and np.ptp(u[a:b]) > MOVES * np.ptp(u) for a, b in stays):
            shown[y == limit] = False
    return None if shown.all() else shown


def feedback_present(pieces: Sequence[Signals]) -> bool:
    """True where a reference moves, or the command holds more than the feedforward."""
    for piece in pieces:
        if piece.r is not None and np.ptp(piece.r) > 0:
            return True
        if piece.f is not None and np.any(np.abs(piece.u - piece.f) > 1e-9 * np.abs(piece.u).max()):
            return True
    return False


def check_excitation(pieces: Sequence[Signals], n_parameters: int, n_states: int) -> None:
    """Refuses data that cannot carry `n_parameters` and one initial state per piece."""
    total = sum(len(piece) for piece in pieces)
    needed = 5 * n_parameters + 2 * n_states * len(pieces)
    where = pieces[0].source
    if total < needed:
        raise InputError(
            f"{where}: {total} samples for {n_parameters} parameters; give at least {needed}, or "
            "ask for a lower order"
        )
    for name in ("u", "y"):
        values = [getattr(piece, name) for piece in pieces]
        if all(np.ptp(v) <= 1e-12 * max(1e-300, np.abs(v).max()) for v in values):
            what = "input" if name == "u" else "output"
            raise InputError(
                f"{where}: the {what} {name} is constant, so nothing can be identified; record one "
                "that moves"
            )
    rank = excitation_rank(pieces, n_states + 1)
    if rank < n_states + 1:
        raise InputError(
            f"{where}: u excites only {rank} directions of {n_states + 1} (a few sines or a short "
            f"pulse?), too few for order {n_states}; use a richer input or a lower order"
        )


def excitation_rank(pieces: Sequence[Signals], lags: int, tolerance: float = 1e-9) -> int:
    """Numerical rank of `lags` delayed copies of the input beside a constant (persistence of
    excitation)."""
    rows = []
    for piece in pieces:
        if len(piece) > lags:
            windows = np.lib.stride_tricks.sliding_window_view(piece.force, lags)
            with_constant = np.column_stack([np.ones(len(windows)), windows])
            rows.append(upper_triangle(with_constant)[1:, 1:])
    if not rows:
        return 0
    singular = np.linalg.svd(np.vstack(rows), compute_uv=False)
    return int(np.sum(singular > tolerance * max(singular[0], 1e-300)))


@dataclass(frozen=True)
class Scale:
    """Units in which u and y have standard deviation one; every matrix of a fit then is of size 1.

    `u_mean`, `y_mean` are taken off first where a free offset makes up for it: an operating point a
    million times the motion must not cost the digits of the motion.
    """

    u: float
    y: float
    u_mean: float = 0.0
    y_mean: float = 0.0

    @classmethod
    def of(cls, pieces: Sequence[Signals], centred: bool = False) -> Scale:
        spread = {
            name: np.sqrt(np.mean([np.var(getattr(p, name)) for p in pieces]))
            for name in ("u", "y")
        }
        mean = {
            name: float(np.mean(np.concatenate([getattr(p, name) for p in pieces])))
            if centred
            else 0.0
            for name in ("u", "y")
        }
        return cls(float(spread["u"]) or 1.0, float(spread["y"]) or 1.0, mean["u"], mean["y"])

    def apply(self, piece: Signals) -> Signals:
        def by(value: Array | None, unit: float) -> Array | None:
            return None if value is None else value / unit

        return replace(
            piece,
            u=(piece.u - self.u_mean) / self.u,
            y=(piece.y - self.y_mean) / self.y,
            r=by(piece.r, self.y),
            f=by(piece.f, self.u),
            d=by(piece.d, self.u),
        )


def fold_weights(pieces: Sequence[Signals], n_folds: int) -> list[tuple[Array, ...]]:
    """Per fold and piece, 1 where a sample is fitted and 0 in the block that is held out.

    Each piece is cut into n_folds + 1 contiguous blocks; the first is always fitted, so that the
    initial state comes from samples that the fit has seen and the run through a held-out block is
    free.
    """
    result = []
    for k in range(1, n_folds + 1):
        weights = []
        for piece in pieces:
            edges = np.linspace(0, len(piece), n_folds + 2).astype(int)
            weight = np.ones(len(piece))
            weight[edges[k] : edges[k + 1]] = 0.0
            weights.append(weight)
        result.append(tuple(weights))
    return result


def needs_controller(controller: Controller | None, pieces: Sequence[Signals]) -> None:
    """Refuses a closed-loop simulation fit without what it simulates from."""
    if controller is None:
        raise InputError(
            "method closed_loop needs the controller; give it (a plant file with [controller]) or "
            "use method prediction_error"
        )
    for piece in pieces:
        if piece.r is None and piece.f is None:
            raise InputError(
                f"{piece.source}: neither r nor f is recorded, so the loop cannot be simulated; use "
                "method prediction_error"
            )
