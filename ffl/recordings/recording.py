"""What came back from a machine: time, reference, feedforward, command, output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ffl.errors import InputError

Array = np.ndarray

COLUMNS = ("t", "r", "f", "u", "y", "d", "y_load")
OPTIONAL = ("d", "y_load")


@dataclass(frozen=True, eq=False)
class Recording:
    """One trial, sampled uniformly: u = u_fb + f drives the machine, y is what it did.

    Attributes
    ----------
    t, r, f, u, y : float arrays of shape (n,)
        Time [s]; reference; feedforward and every other known injection; total actuator command
        as sent; measured output. An open-loop machine has r = 0 and u = f.
    d : float array of shape (n,) or None
        Known load, in the command's unit, positive where it pushes the way u does.
    y_load : float array of shape (n,) or None
        Position behind the transmission, by a second encoder: same unit, scale and sign as y.
    sample_time : float [s]
    units : what is known of the units, by column, e.g. {"y": "m", "u": "N"}
    source : the file (and the name within it) that this came from
    missing : columns that were not measured but filled in; a command that nothing in the file
        determines (u = f + C(r - y) with a controller elsewhere) is NaN until `with_command`
    notes : what was done to the samples on the way here, one sentence each
    others : columns of the file that nothing above is made of, by name, each (n,)

    Raises `InputError` where lengths differ or a column is not one-dimensional and real. Whether
    the samples themselves can be trusted is asked with `check_recording` and `soundness`.
    """

    t: Array
    r: Array
    f: Array
    u: Array
    y: Array
    d: Array | None = None
    y_load: Array | None = None
    sample_time: float = field(kw_only=True)
    units: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    source: str = field(default="recording", kw_only=True)
    missing: frozenset[str] = field(default=frozenset(), kw_only=True)
    notes: tuple[str, ...] = field(default=(), kw_only=True)
    others: Mapping[str, Array] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        for name in COLUMNS:
            values = getattr(self, name)
            if values is None and name in OPTIONAL:
                continue
            object.__setattr__(self, name, _column(values, name, self.source))
        lengths = {name: len(x) for name in COLUMNS if (x := getattr(self, name)) is not None}
        if len(set(lengths.values())) != 1:
            said = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise InputError(
                f"{self.source}: columns have unequal lengths ({said}); give every column one "
                "value per sample"
            )
        sample_time = float(self.sample_time)
        if not (np.isfinite(sample_time) and sample_time > 0):
            raise InputError(
                f"{self.source}: sample_time = {sample_time:g} s; give a positive number of seconds"
            )
        object.__setattr__(self, "sample_time", sample_time)
        object.__setattr__(self, "missing", frozenset(self.missing))
        # Columns of samples that are no more, of a recording that was resampled, say nothing of these.
        whole = {name: x for name, x in self.others.items() if len(x) == lengths["y"]}
        object.__setattr__(self, "others", whole)

    @classmethod
    def from_signals(
        cls,
        sample_time: float,
        *,
        y: Array,
        u: Array | None = None,
        r: Array | None = None,
        f: Array | None = None,
        d: Array | None = None,
        y_load: Array | None = None,
        t: Array | None = None,
        start: float = 0.0,
        units: Mapping[str, str] | None = None,
        source: str = "recording",
        notes: tuple[str, ...] = (),
    ) -> Recording:
        """A recording from what was measured; the rest is filled in and named in `missing`.

        t = start + k sample_time. Without r the machine is taken as open loop: r = 0 and, of u
        and f, the one that is there serves for both. With r and without f: f = 0. With r and
        without u: u is NaN, since only the controller knows it. Neither u nor f, nor r: an
        `InputError`, since nothing then says what drove the machine.

        >>> Recording.from_signals(0.01, y=[0.0, 1.0], u=[1.0, 1.0]).f
        array([1., 1.])
        """
        given = {"t": t, "r": r, "f": f, "u": u}
        missing = {name for name, values in given.items() if values is None}
        y = _column(y, "y", source)
        n = len(y)
        if r is None:
            drive = f if u is None else u
            if drive is None:
                raise InputError(
                    f"{source}: nothing says what drove the machine; give u, or f, or r where a "
                    "controller is known"
                )
            u, f = drive, (drive if f is None else f)
            r = np.zeros(n)
        else:
            f = np.zeros(n) if f is None else f
            u = np.full(n, np.nan) if u is None else u
        if t is None:
            t = start + sample_time * np.arange(n)
        said = tuple(_FILLED[name] for name in ("r", "f", "u") if name in missing)
        return cls(
            t,
            r,
            f,
            u,
            y,
            d,
            y_load,
            sample_time=sample_time,
            units=dict(units or {}),
            source=source,
            missing=frozenset(missing),
            notes=(*notes, *said),
        )

    def __len__(self) -> int:
        return len(self.y)

    def __getitem__(self, rows: slice) -> Recording:
        """Consecutive samples, e.g. `recording[100:200]`; times stay those of the machine."""
        if not isinstance(rows, slice) or rows.step not in (None, 1):
            raise TypeError("a recording is cut by recording[start:stop], without a step")
        start, stop, _ = rows.indices(len(self))
        if stop - start < 1:
            raise InputError(f"{self.source}: rows {start} to {stop} of {len(self)} hold no sample")
        parts = {
            name: values[rows] for name in COLUMNS if (values := getattr(self, name)) is not None
        }
        others = {name: values[rows] for name, values in self.others.items()}
        return replace(self, **parts, others=others)

    def between(self, start: float, stop: float) -> Recording:
        """The samples with start <= t < stop [s]."""
        first, last = np.searchsorted(self.t, [start, stop], side="left")
        if first >= last:
            raise InputError(
                f"{self.source}: no sample between {start:g} and {stop:g} s; it runs from "
                f"{self.t[0]:g} to {self.t[-1]:g} s"
            )
        return self[int(first) : int(last)]

    @property
    def duration(self) -> float:
        """n sample_time [s]: every sample holds for one sample time."""
        return len(self) * self.sample_time

    @property
    def error(self) -> Array:
        """r - y."""
        return self.r - self.y

    @property
    def is_open_loop(self) -> bool:
        """True where no reference was measured, or it is zero throughout."""
        return "r" in self.missing or not np.any(self.r)

    def with_command(self, feedback: Array) -> Recording:
        """The recording with u = f + feedback, for a file without u whose controller is known."""
        note = "u is not measured: computed as f plus the controller's output"
        notes = (*(n for n in self.notes if n != _FILLED["u"]), note)
        return replace(self, u=self.f + np.asarray(feedback, dtype=float), notes=notes)


_FILLED = {
    "r": "no reference in the file: taken as open loop, r = 0",
    "f": "no feedforward in the file: taken from the command in open loop, 0 in closed loop",
    "u": "no command in the file: it follows from the feedforward and the controller",
}


def _column(values: object, name: str, source: str) -> Array:
    try:
        column = np.asarray(values)
        if column.dtype.kind not in "biuf":
            raise TypeError
        column = np.ascontiguousarray(column, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{source}: column {name} is not an array of real numbers") from None
    if column.ndim != 1:
        raise InputError(
            f"{source}: column {name} has shape {column.shape}; give one value per sample"
        )
    return column


def shared_clock(recordings: tuple[Recording, ...] | list[Recording]) -> bool:
    """True where the recordings tell one time: no two overlap. Otherwise the offset is unknown."""
    spans = sorted((x.t[0], x.t[-1], x.sample_time) for x in recordings)
    return all(b[0] > a[1] + 0.5 * a[2] for a, b in pairwise(spans))
