"""Recordings made ready: what drove the loop, what came out, and the state it started from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffl.diagnose.hypothesis.linear import carried
from ffl.diagnose.recorded.commands import as_limited, asked_for, feedback_of, limit_of
from ffl.diagnose.recorded.first_state import behind_sensor, in_motion_from
from ffl.diagnose.recorded.resting import Pull, rest_under, springs_back, winds, wound
from ffl.effects import EFFECTS, Mechanics
from ffl.effects.modal import is_speed
from ffl.effects.motion import Extent
from ffl.errors import InputError
from ffl.machines.simulator import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

SPAN = 0.01  # s over which speed is read from y
HOLD = 1000  # most samples over which the place of a machine at rest is read
TURN = 1e-3  # of the range of y: a way back that is a turning point
MOVING = 0.1  # of the largest speed: in motion at the first sample
# Share of samples, and standard deviations of noise, that `largest` leaves out.
RARE, LOUD = 1e-3, 5.0


@dataclass(frozen=True)
class Trial:
    """One recording: `reference`, `feedforward` and `load` (beside the command, input units) drive
    the simulated loop; `y`, `u` are measured. `start` is the loop's state at the first sample (as
    `Simulator.run` takes it) and `doubt` its covariance over the states of the linear loop, both in
    the states of `mechanics`.
    """

    name: str
    start_time: float
    sample_time: float
    reference: Array
    feedforward: Array
    load: Array | None
    y: Array
    u: Array
    start: Array
    doubt: Array
    at_rest: bool
    mechanics: Mechanics
    travel: float = 0.0  # in one direction until the first sample, as near as it is known
    loaded: bool = False  # at rest with its springs wound up by what pulls and holds it
    adrift: tuple[Array, Array] | None = None  # start and doubt, were rest motion or the reverse
    off: bool = False  # the drive was off until the first sample
    held: float | None = None  # command until the first sample, where it was found
    unrest: Array | None = None  # times as loud as whitened noise should be (see `unrest`), >= 1
    warm: float = 0.0  # squared command that had warmed the machine before (see `warmth`)
    asked: Array | None = None  # by the controller, where the drive's stated limit was reached
    goes_on: bool = False  # a later piece of the recording before it
    lost: Array | None = None  # which samples a sensor at its limit could not show (see `clip`)
    folded: bool = False  # y has the signs that its sensor is blind to (see `signs`)
    others: Mapping[str, Array] = field(default_factory=dict)  # what else was recorded, by name
    place: float | None = None  # where it begins, of an output that is a speed, if known (`angles`)

    def __len__(self) -> int:
        return len(self.y)

    @property
    def recorded(self) -> Trial:
        """With y as the sensor showed it."""
        return replace(self, y=np.abs(self.y), folded=False) if self.folded else self

    @property
    def started(self) -> bool:
        """Begun in motion, in a state that was read from its first samples."""
        return not self.at_rest and bool(np.any(np.diag(self.doubt) > 0))

    @property
    def drive(self) -> tuple[object, ...]:
        """What a simulation takes of it, signals and states by identity: the same for trials that differ
        in what their samples count for."""
        arrays = self.reference, self.feedforward, self.load, self.u, self.start, self.mechanics
        start = self.start_time, self.travel, self.loaded, self.at_rest, self.off, self.place or 0.0
        return (*map(id, arrays), *start)

    @property
    def before(self) -> float:
        """The command held until the first sample, as near as it is known: the first one, input
        units; none where the drive was off. A machine that holds a spring has had it for long."""
        known = 0.0 if self.off else self.held
        return float(self._command[0]) if known is None else known

    @property
    def before_it(self) -> dict[str, Any]:
        """What a simulation is told of the time before the first sample."""
        return {"before": self.before, "travel": self.travel, "place": self.place or 0.0}

    @property
    def holding(self) -> float:
        """What drives the machine, a known load too, in the mean over the first samples: noise left out."""
        return _at_first(self._command, self.load)

    @property
    def _command(self) -> Array:
        return self.u if np.isfinite(self.u[0]) else self.feedforward

    @cached_property
    def largest(self) -> float:
        """|y| that more than one sample in a thousand comes to, less what noise may add (a straight line's
        second difference is sqrt(6) times as loud as its noise)."""
        noise = np.std(np.diff(self.y, 2)) / np.sqrt(6.0) if len(self) > 3 else 0.0
        return float(max(np.quantile(np.abs(self.y), 1.0 - RARE) - LOUD * noise, 0.0))

    @cached_property
    def fastest(self) -> float:
        """The speed, over `SPAN`, that more than one sample in a thousand comes to."""
        span = min(max(1, round(SPAN / self.sample_time)), max(len(self) - 1, 1))
        way = np.abs(self.y[span:] - self.y[:-span])
        return float(np.quantile(way, 1.0 - RARE)) / (span * self.sample_time) if len(way) else 0.0

    def head(self, rows: int) -> Trial:
        """The first `rows` samples."""
        parts = {k: getattr(self, k)[:rows] for k in ("reference", "feedforward", "y", "u")}
        for name in ("load", "unrest", "asked", "lost"):
            whole = getattr(self, name)
            parts[name] = None if whole is None else whole[:rows]
        return replace(self, **parts, others={k: x[:rows] for k, x in self.others.items()})

    def beside(self, y: Array) -> Array:
        """What was measured less `y` (N,), straight over what the sensor lost."""
        e = self.y - y
        if self.lost is None or not self.lost.any() or self.lost.all():
            return e
        rows = np.arange(len(e))
        return np.where(self.lost, np.interp(rows, rows[~self.lost], e[~self.lost]), e)

    def weighed(self, white: Array) -> Array:
        """`white`, (n,) or (n, k), the whitened first n samples, by what each counts for."""
        if self.unrest is None:
            return white
        rows = self.unrest[: len(white)]
        return white / (rows if white.ndim == 1 else rows[:, None])

    def held_before(self, rows: int) -> Trial:
        """The recording with `rows` samples before it in which nothing changes yet."""

        def longer(x: Array) -> Array:
            return np.concatenate([np.full(rows, x[0]), x])

        load, asked, lost = (
            None if x is None else longer(x) for x in (self.load, self.asked, self.lost)
        )
        return replace(
            self, reference=longer(self.reference), feedforward=longer(self.feedforward), load=load,
            y=longer(self.y), u=longer(self.u), asked=asked, lost=lost,
            start_time=self.start_time - rows * self.sample_time, unrest=None,
            others={name: longer(x) for name, x in self.others.items()},
        )  # fmt: skip

    @property
    def t(self) -> Array:
        return self.start_time + self.sample_time * np.arange(len(self.y))


def stretches(recordings: Sequence[Recording], most: int, pieces: int = 4) -> list[Recording]:
    """The recordings themselves, or, where they hold more than `most` samples together, evenly
    spread stretches of half as many: a contest of a hundred fits needs no more to name physics."""
    total = sum(len(r) for r in recordings)
    if total <= most:
        return list(recordings)
    out = []
    for r in recordings:
        length = max(len(r) * most // (2 * total * pieces), min(len(r) // pieces, 1000))
        for k in range(pieces):
            start = k * (len(r) - length) // (pieces - 1)
            start = in_motion(r, start, length // 8) if k else 0
            out.append(r[start : start + length])
    return out


def blocks(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """About the first 70 % of every recording, and the rest."""
    cuts = [in_motion(r, int(0.7 * len(r)), len(r) // 20) for r in recordings]
    pairs = list(zip(recordings, cuts, strict=True))
    return [r[:cut] for r, cut in pairs], [r[cut:] for r, cut in pairs]


def in_motion(recording: Recording, sample: int, reach: int) -> int:
    """Where within `reach` of `sample` y changes fastest: what holds a machine at standstill, or just
    let it go, is not known at a cut; in motion friction is on one side."""
    span = max(1, min(reach // 4, round(SPAN / recording.sample_time)))
    low, high = max(span, sample - reach), min(len(recording) - span, sample + reach + 1)
    if high - low < 2:
        return sample
    y = recording.y
    speed = np.abs(y[low + span : high + span] - y[low - span : high - span])
    return low + int(np.argmax(speed))


def commanded(plant: Plant, recording: Recording) -> Recording:
    """The recording with u = f + C_r r - C_y y where it was not measured, the controller is known and
    the start is at rest, so that the controller's state there is no secret; held to the drive's limit.
    Of a controller that nobody knows u is all that drives the machine, whatever r is."""
    unknown = not np.all(np.isfinite(recording.u))
    if plant.controller is None and not (unknown or recording.is_open_loop):
        nobody = recording.missing | {"r", "f"}
        return replace(recording, r=np.zeros(len(recording)), f=recording.u, missing=nobody)
    if plant.controller is None or not unknown or not starts_at_rest(recording):
        return recording
    return as_limited(plant, recording.with_command(feedback_of(plant.controller, recording)[1]))


def starts_at_rest(recording: Recording) -> bool:
    """The reference (the command in open loop) holds still at first, and so does y."""
    rows = _first_rows(len(recording))
    drive = recording.f if recording.is_open_loop else recording.r
    scale = np.ptp(drive)
    if np.ptp(drive[:rows]) > 1e-6 * max(scale, 1e-300):
        return False
    force = recording.u if np.all(np.isfinite(recording.u)) else recording.f
    if not recording.is_open_loop and np.ptp(recording.f[:rows]) > 0.02 * np.ptp(force):
        return False
    y = recording.y[:rows]
    travel = abs(np.polyfit(np.arange(rows), y, 1)[0]) * rows
    spread = np.std(np.diff(y)) + 1e-300
    return bool(travel < 6 * spread or travel < 1e-4 * np.ptp(recording.y))


def _standing(recording: Recording) -> float:
    """Where a recording that begins at rest stands: y over as long as the drive holds still, or over its
    first samples where y does not stay there. A machine that sticks keeps what is wrong with this
    until it breaks away."""
    drive = recording.f if recording.is_open_loop else recording.r
    moved = np.abs(drive - drive[0]) > 1e-6 * max(float(np.ptp(drive)), 1e-300)
    still = np.abs(recording.f - recording.f[0]) <= 1e-6 * max(float(np.ptp(recording.f)), 1e-300)
    rows = int(np.argmax(moved | ~still)) or len(recording)
    short = recording.y[: max(8, min(20, len(recording)))]
    y = recording.y[: min(rows, HOLD)]
    parts = np.array_split(y, 8)
    if len(y) < 2 * len(short):
        return float(np.mean(short))
    means = np.array([np.mean(part) for part in parts])
    spread = float(np.std(np.diff(y))) / np.sqrt(2.0)
    slow = float(np.std(np.diff(means))) / np.sqrt(2.0)  # coloured noise moves short means too
    off = abs(float(np.mean(means[:4]) - np.mean(means[4:])))
    stays = off < 4.0 * max(spread / np.sqrt(len(y) / 4), slow)
    return float(np.mean(y if stays else short))


def prepared(
    simulator: Simulator, recordings: Sequence[Recording], noise: float
) -> tuple[Trial, ...]:
    """The trials of `recordings`; those that are later pieces of the recording before them say so."""
    out: list[Trial] = []
    for recording in recordings:
        trial = prepare(simulator, recording, noise)
        later = out and out[-1].name == trial.name and trial.start_time > out[-1].t[-1]
        out.append(replace(trial, goes_on=bool(later)))
    return tuple(out)


def _first_rows(samples: int) -> int:
    """How many first samples of a recording tell what it began with."""
    return max(8, min(40, samples // 50))


def _at_first(command: Array, load: Array | None) -> float:
    """The command, and a known load with it, in the mean over the first samples."""
    rows = _first_rows(len(command))
    return float(np.mean(command[:rows] + (0.0 if load is None else load[:rows])))


def prepare(simulator: Simulator, recording: Recording, noise: float) -> Trial:
    """The trial of a recording under the plant (and controller) of `simulator`."""
    plant = simulator.plant
    if abs(recording.sample_time - plant.sample_time) > 1e-3 * plant.sample_time:
        raise InputError(
            f"{recording.source}: sample time {recording.sample_time:g} s, the model's is "
            f"{plant.sample_time:g} s; resample the recording or give the model of this rate"
        )
    rest = starts_at_rest(recording)
    n_plant, n = simulator.n_plant, simulator.n_states
    delay = simulator.mechanics.delay
    start = np.zeros(n)
    doubt = np.zeros((n_plant + delay + simulator.controller.order,) * 2)
    first = _standing(recording) if rest else 0.0
    known_command = np.all(np.isfinite(recording.u))
    if rest:
        start[:] = simulator.at_rest(first)
        if springs_back(simulator) or plant.controller is not None:
            if delay and known_command:
                start[n_plant : n_plant + delay] = _at_first(recording.u, recording.d)
        elif simulator.mechanics.order:
            # In open loop rest is where the first command holds it.
            held = float(recording.u[0]) + _loads(simulator, plant.effects)
            start = rest_under(simulator, float(recording.u[0]), held, first)
    adrift = None
    if known_command and (plant.controller is not None or not rest):
        adrift = in_motion_from(simulator, recording, noise)
    if not rest and adrift is not None:
        start[: n_plant + delay], doubt = adrift[0][: n_plant + delay], adrift[1]
    asked = None
    if plant.controller is not None and known_command:
        states, fed_back = feedback_of(plant.controller, recording, limit_of(plant))
        asked = asked_for(plant, recording, fed_back)
        assert adrift is not None  # the command is known
        for whole in (start, adrift[0]):
            whole[n_plant + delay :] = states
    return Trial(
        recording.source,
        float(recording.t[0]),
        plant.sample_time,
        np.asarray(recording.r),
        np.asarray(recording.f),
        None if recording.d is None else np.asarray(recording.d),
        np.asarray(recording.y),
        np.asarray(recording.u),
        start,
        doubt,
        rest,
        simulator.mechanics,
        0.0 if rest else _travel(recording, is_speed(plant.output_unit)),
        rest and springs_back(simulator),
        adrift if rest else None,
        asked=asked,
        others=recording.others,
    )


def _loads(simulator: Simulator, effects: Sequence[EffectSpec]) -> float:
    """The command that the constant loads among `effects` stand for."""
    total, m = 0.0, simulator.mechanics
    for spec in effects:
        if spec.name == "constant_load":
            side, ratio = spec.options.get("side", "sensor"), spec.options.get("mass_ratio")
            total += spec.parameters["force"] * m.as_command(m.point(side, ratio))
    return total / simulator.force_per_input


def _travel(recording: Recording, speed: bool) -> float:
    """From the first sample to the first turning point, signed: as likely as not, as far as it was from
    the last one to the first sample. 0 where the machine hardly moves at first: which way it came
    is then unknown."""
    y = np.cumsum(recording.y) * recording.sample_time if speed else recording.y
    span = min(max(round(SPAN / recording.sample_time), 8), len(y) - 1)
    moved = np.abs(y[span:] - y[:-span])
    if moved[0] < MOVING * moved.max():
        return 0.0
    sign = np.sign(y[span] - y[0])
    along = sign * (y - y[0])
    farthest = np.maximum.accumulate(along)
    back = farthest - along > TURN * float(np.ptp(y))
    return float(sign * farthest[np.argmax(back) if back.any() else -1])


def start_of(
    simulator: Simulator, effects: Sequence[EffectSpec], trial: Trial, pulls: Sequence[Pull] = ()
) -> Array:
    """`trial.start` in the states of `simulator`, with the plant where the sensor, `effects` included,
    shows what was measured: a loop at rest has brought what it sees to the reference, not what is."""
    start = trial.start
    if simulator.mechanics is not trial.mechanics:
        start = carried(start, trial.mechanics, simulator.mechanics)
    shown = [(EFFECTS[s.name], s.parameters) for s in effects if EFFECTS[s.name].port == "output"]
    if not trial.at_rest:
        return start
    if trial.loaded and winds(simulator, effects, pulls):
        start = wound(simulator, effects, trial.holding, trial.start_time, start, pulls)
    if not shown or simulator.plant.controller is None:
        return start
    return behind_sensor(
        simulator, start, lambda x: sum(effect.shown(values, x) - x for effect, values in shown)
    )


def extent(trials: Sequence[Trial], travel: float, output_unit: str) -> Extent:
    """How far the fitted `trials` reach; the `travel` is that of any recording."""
    duration = max(len(trial) * trial.sample_time for trial in trials)
    largest = max(trial.largest for trial in trials)
    if is_speed(output_unit):  # and where it was is not known
        return Extent(duration, travel or np.inf, largest, largest or np.inf)
    fastest = max(trial.fastest for trial in trials)
    ends = min(float(t.y.min()) for t in trials), max(float(t.y.max()) for t in trials)
    return Extent(duration, travel or np.inf, largest, fastest or np.inf, *ends)
