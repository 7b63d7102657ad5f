"""A model with smooth maps in it: run in the kernel or by repetition, fitted as a Gaussian process."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ffl.diagnose.contest.judging import LIGHT, is_another
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.fit import Fit, jacobian
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.hypothesis.triangle import triangle
from ffl.diagnose.maps.mapped import BY_POSITION, Mapped
from ffl.diagnose.maps.terms import Ranges, Term
from ffl.diagnose.recorded.first_state import behind_sensor, shown_in, start_behind
from ffl.diagnose.recorded.resting import Pull
from ffl.diagnose.recorded.trials import Trial, start_of
from ffl.diagnose.screen.screen import Screen
from ffl.effects import EFFECTS, Motion
from ffl.errors import InputError
from ffl.machines.simulator import Simulation
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

SENT = "sent"  # side of a map that sees the command as it was recorded
REPEATS = 8  # most repetitions of a simulation: the map moves the machine, the motion moves the map
RUNAWAY = 1e100  # of a trace in whitened y: the motion it belongs to has run away
SETTLED = 1e-3  # change of y between two of them, relative to what the maps do to y
SIZES = np.geomspace(1e-2, 1e7, 28)  # prior variances of a map's trace in whitened y


@dataclass(frozen=True)
class Part:
    """A fitted map: `term` at `place` with its `coefficients` (k,) over `ranges`."""

    term: Term
    place: Place
    coefficients: Array
    ranges: Ranges
    length: float = 1.0

    def same(self, other: Part) -> bool:
        """The same family of maps at the same place."""
        return self.term is other.term and self.place == other.place

    def signal(self, motion: Motion) -> Array:
        """The map along a motion, (N,): force or command in input units, or output units."""
        return self.term.signal(motion, self.ranges, self.coefficients)


@dataclass(frozen=True)
class FreeModel:
    """`model` with maps beside it; force maps that are repeated share one place."""

    model: Model
    parts: tuple[Part, ...] = ()

    @property
    def believable(self) -> bool:
        """The machine beside the maps is still the stated one, and no map of the command holds most of it
        back from a fraction of the mass (which explains any force that takes the command up: a damper at
        one end of a stroke was a limit by speed, of a diverter with 82 % less mass)."""
        sent = any(part.place.port == "command" for part in self.parts)
        light = sent and self.model.corrections.get("mass", 0.0) < LIGHT
        return not light and not is_another(self.model)

    def simulate(
        self, trial: Trial, places: Sequence[Place] = ()
    ) -> tuple[Simulation, dict[Place, Motion]] | None:
        """The free-running loop and the motion at `places` and at the maps' own; None where it leaves
        all bounds. The signals of maps that the kernel does not run are repeated until the motion they
        make is the one they saw."""
        wanted = list(dict.fromkeys([*places, *(p.place for p in self.parts)]))
        keys = [side_of(place) for place in wanted]
        pairs = list(zip(wanted, keys, strict=True))
        run = self._driven(trial, {}, keys)
        before, change, share = run.y, np.inf, 1.0
        ports: dict[str, Array] = {}
        for _ in range(REPEATS if self._repeated else 0):
            if run.diverged:
                return None
            motions = {p: _seen(run.motion(*k), p, trial) for p, k in pairs}
            with np.errstate(over="ignore", invalid="ignore"):  # a map that runs away
                fresh = self._signals(motions)
            if not all(np.all(np.isfinite(signal)) for signal in fresh.values()):
                return None
            ports = {k: v + (1 - share) * (ports[k] - v) if ports else v for k, v in fresh.items()}
            other = self._driven(trial, ports, keys)
            if other.diverged:
                return None
            moved = float(np.abs(other.y - run.y).max())
            if moved > 0.7 * change:
                share = max(0.5 * share, 0.2)
            run, change = other, moved
            if change <= SETTLED * float(np.abs(run.y - before).max()):
                break
        if run.diverged:
            return None
        return run, {p: _seen(run.motion(*k), p, trial) for p, k in pairs}

    def follow(
        self, trial: Trial, places: Sequence[Place] = ()
    ) -> tuple[Simulation, dict[Place, Motion]] | None:
        """`simulate` behind what bends the command, as the model itself is judged."""
        machine, (own,) = self.model.judged_on([trial])
        return FreeModel(machine, self.parts).simulate(own, places)

    def beside(self, part: Part) -> FreeModel:
        """With one more map."""
        return FreeModel(self.model, (*self.parts, part))

    # --- as a model is ---------------------------------------------------------------------------

    @property
    def theta(self) -> Array:
        """The free numbers of the model beside the maps."""
        return self.model.theta

    @property
    def coordinates(self) -> Sequence[Coordinate]:
        return self.model.coordinates

    def at(self, theta: Array) -> FreeModel:
        """Other numbers beside the same maps."""
        return FreeModel(self.model.at(theta), self.parts)

    @property
    def substeps(self) -> int:
        return self.model.substeps

    def output(self, trial: Trial) -> Array | None:
        """y of the run, None where there is no such machine or it leaves all bounds."""
        try:
            found = self.follow(trial)
        except InputError:
            return None
        return None if found is None else found[0].y

    # --- which maps the kernel runs --------------------------------------------------------------

    def _runs(self, part: Part) -> bool:
        """Whether the kernel runs the map: not those of a history, or of the command as recorded, nor those
        at a port where effects act, which would see what these make of it."""
        taken = {EFFECTS[spec.name].port for spec in self.model.acting} - {"force"}
        return part.term.kind is not None and part.place.port not in taken

    @cached_property
    def _repeated(self) -> list[Part]:
        return [part for part in self.parts if not self._runs(part)]

    @cached_property
    def _mapped(self) -> list[tuple[Mapped, EffectSpec]]:
        maps = [Mapped(part) for part in self.parts if self._runs(part)]
        return [(one, one.spec) for one in maps]

    def _signals(self, motions: dict[Place, Motion]) -> dict[str, Array]:
        """What the maps put in at each port along these motions."""
        ports: dict[str, Array] = {}
        for part in self._repeated:
            signal = part.signal(motions[part.place])
            port = part.place.port
            ports[port] = ports[port] + signal if port in ports else signal
        return ports

    def _driven(self, trial: Trial, ports: dict[str, Array], keys: Sequence) -> Simulation:  # type: ignore[type-arg]
        forces = (
            [part.place for part in self._repeated if part.place.port == "force"] if ports else []
        )
        side = side_of(forces[0]) if forces else None
        load = ports.get("command")
        if trial.load is not None:
            load = trial.load if load is None else load + trial.load
        start = self._start(trial)
        return self.model.simulator.run(
            self.model.acting, trial.reference, trial.feedforward, force=load,
            noise=ports.get("output"), start=start, start_time=trial.start_time,
            watch=list(dict.fromkeys(keys)), substeps=self.model.substeps,
            command_limit=self.model.base.limit, **trial.before_it,
            applied=(ports["force"], side) if side else None, others=self._mapped,
        )  # fmt: skip

    @property
    def pulls(self) -> tuple[Pull, ...]:
        """What the maps of the position pull with at standstill."""
        pulling = [p for p in self.parts if p.term.kind == BY_POSITION]
        return tuple(Pull(*side_of(p.place), partial(_still, p)) for p in pulling)

    def _start(self, trial: Trial) -> Array:
        """The state at the first sample: a loop at rest has brought what a sensor shows to the
        reference, maps at the sensor included; in motion they are part of what was read."""
        simulator = self.model.base.simulator
        start = start_of(simulator, self.model.acting, trial, self.pulls)
        shown = [p for p in self.parts if p.place.port == "output" and not p.term.column]
        if shown and self.model.base.keeps_start(trial):
            head = trial.head(shown_in(simulator, len(trial)))
            motion = self.model.simulate(head, [side_of(shown[0].place)]).motion("sensor", None)
            added_to = sum((p.signal(motion) for p in shown), np.zeros(len(motion.t)))
            return start + start_behind(simulator, added_to)
        if not trial.at_rest or not shown or simulator.plant.controller is None:
            return start

        def added(position: float) -> float:
            still = Motion.still(position, trial.sample_time)
            return sum(float(p.signal(still)[0]) for p in shown)

        return behind_sensor(simulator, start, added)


def _still(part: Part, position: float) -> float:
    """Force of the map where the machine stands, input units."""
    return float(part.signal(Motion.still(position, 1.0))[0])


class Running:
    """A model with maps as `starts` runs it."""

    def __init__(self, free: FreeModel) -> None:
        self.free, self.base, self.acting = free, free.model.base, free.model.acting
        self.pulls = free.pulls

    def follow(self, trial: Trial) -> Simulation:
        found = self.free.follow(trial)
        if found is not None:
            return found[0]
        run = self.free.model.follow(trial)
        return replace(run, y=np.full(len(trial), np.nan))


def motions_of(
    free: FreeModel, scene: Scene, places: Sequence[Place]
) -> list[dict[Place, Motion]] | None:
    found = [free.follow(trial, list(dict.fromkeys(places))) for trial in scene.trials]
    return None if any(f is None for f in found) else [f[1] for f in found if f is not None]


@dataclass(frozen=True)
class Run:
    """What the fitted recordings are with the maps: whitened residual, motions at the maps' places."""

    white: Array
    motions: list[dict[Place, Motion]]

    @cached_property
    def cost(self) -> float:
        with np.errstate(over="ignore", invalid="ignore"):  # a step that runs far
            cost = float(self.white @ self.white)
        return cost if np.isfinite(cost) else np.inf


def run_of(scene: Scene, free: FreeModel) -> Run | None:
    """None where a simulation leaves all bounds."""
    try:
        found = [free.follow(trial) for trial in scene.trials]
    except InputError:
        return None
    runs = [f for f in found if f is not None]
    if len(runs) < len(found):
        return None
    left = [t.y - run.y for t, (run, _) in zip(scene.trials, runs, strict=True)]
    return Run(scene.whiten(left), [motions for _, motions in runs])


class FreeScreen(Screen):
    """A screen whose model's own numbers are believed to be near nominal (`Coordinate.doubt`), so that
    a map takes what they cannot and no more is laid to them than an engineer's error."""

    believing = True

    def __init__(self, scene: Scene, free: FreeModel, along: Scene | None = None) -> None:
        """Raises `InputError` where `free` leaves all bounds."""
        base = scene.residuals(free)
        if base is None:
            raise InputError("a map runs away: nothing is to be seen beside it")
        columns = jacobian(scene, free, base)
        white, slopes = scene.whiten(base), scene.whiten_stacked(columns)
        super().__init__(scene, Fit(free.model, white, slopes, columns, "rounds"), along)

    def _slopes(self, along: Scene, left: Sequence[Array]) -> Array:
        """None, (N, 0): the model's numbers are held along the measured motion. With mass, damping,
        stiffness and the command all taken off, any command map explains it (and the machine is none)."""
        return np.zeros((along.samples, 0))

    def of(self, scene: Scene) -> FreeScreen:
        """The same along another scene, whose recordings began otherwise."""
        other = copy.copy(self)
        other.scene, other.passage = scene, self.passage.of(scene)
        return other

    def from_nominal(self, model: Model) -> Array:
        """What the believed numbers of `model` do to the whitened y, (N,); nothing where they are held."""
        if not self.slopes.shape[1]:
            return np.zeros(len(self.wanted))
        own = np.isfinite([c.doubt for c in model.coordinates])
        return self.slopes[:, own] @ model.theta[own]


def _seen(motion: Motion, place: Place, trial: Trial) -> Motion:
    """The motion that a map at `place` sees. A limit cuts off what feedback then asks for again: its
    repetition does not come to rest, and the command as recorded is what was cut."""
    motion = replace(motion, warm=trial.warm) if trial.warm else motion
    motion = replace(motion, others=trial.others) if trial.others else motion
    if place.side != SENT or not np.all(np.isfinite(trial.u)):
        return motion
    return replace(motion, u=trial.u)


def side_of(place: Place) -> tuple[str, float | None]:
    return (place.side if place.port == "force" else "sensor", place.mass_ratio)


def held_motion(motion: Motion, place: Place) -> Motion:
    """Forces of the screen's filters are held over a sample: theirs is the motion at its middle."""
    return motion.mid_sample if place.port == "force" else motion


@dataclass(frozen=True)
class Evidence:
    """Best size and length of a map's prior, and the log-evidence gained over no map."""

    gain: float
    size: float
    length: float


def evidence(
    term: Term, ranges: Ranges, table: Array, target: Array, shortest: float = 0.0
) -> Evidence:
    """log p(target | map) - log p(target | no map) of the best prior, target = table c + white noise;
    `shortest`: least length of a map over a grid."""
    best = Evidence(-np.inf, 0.0, 1.0)
    if not np.all(np.abs(table) < RUNAWAY):
        return best
    r, projected = triangle(table, target)
    scale = float(np.sum(table**2)) / len(table)
    if scale <= 0:
        return best
    for length in (at for at in term.lengths if at >= shortest):
        kernel = term.kernel(ranges, length)
        values, vectors = np.linalg.eigh(r @ kernel @ r.T / scale)
        values = np.maximum(values, 0.0)
        q = (vectors.T @ projected) ** 2
        grown = SIZES[:, None] * values
        gain = 0.5 * np.sum(q * grown / (1 + grown) - np.log1p(grown), axis=1)
        k = int(np.argmax(gain))
        if gain[k] > best.gain:
            best = Evidence(float(gain[k]), float(SIZES[k] / scale), length)
    return best


def posterior(
    terms: Sequence[Term],
    ranges: Sequence[Ranges],
    tables: Sequence[Array],
    priors: Sequence[Evidence],
    target: Array,
) -> list[Array]:
    """Most probable coefficients of all maps together, by QR."""
    roots = []
    for term, span, prior in zip(terms, ranges, priors, strict=True):
        kernel = term.kernel(span, prior.length) * prior.size
        values, vectors = np.linalg.eigh(kernel)
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    seen = np.hstack([t @ root for t, root in zip(tables, roots, strict=True)])
    r, projected = triangle(seen, target)
    k = seen.shape[1]
    q, small = np.linalg.qr(np.vstack([r, np.eye(k)]))
    whole = np.linalg.solve(small, q[:k].T @ projected)
    pieces = np.split(whole, np.cumsum([root.shape[1] for root in roots])[:-1])
    return [root @ piece for root, piece in zip(roots, pieces, strict=True)]


def tables_of(
    screen: FreeScreen, entries: Sequence[tuple[Term, Place]],
    ranges: Sequence[Ranges], motions: Sequence[dict[Place, Motion]],
) -> list[Array]:  # fmt: skip
    """Whitened traces (N, k) of each entry's columns along the given motions."""
    out = []
    for (term, place), span in zip(entries, ranges, strict=True):
        columns = [term.columns(held_motion(m[place], place), span) for m in motions]
        out.append(screen.through(place, columns))
    return out
