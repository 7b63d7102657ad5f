"""Screening: what each effect would add to y to first order, against the whitened residual.

Regressors come from simulated motion (measured motion would carry the present noise into them), go
through the closed loop from the port where they act to y, through the whitening filter, and are
judged by what they take off the residual beyond the linear model's own freedom.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, jacobian
from ffl.diagnose.hypothesis.places import (
    Place,
    behind_a_mode,
    distinct_forces,
    drive_places,
    flow_places,
    mass_is_corrected,
    places_of,
)
from ffl.diagnose.hypothesis.span import believed, orthonormal
from ffl.diagnose.hypothesis.triangle import lengths, triangle
from ffl.diagnose.noise.passage import Passage
from ffl.diagnose.predict.as_sent import is_drive
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.screen.candidate import Candidate, spec_of
from ffl.diagnose.screen.clocks import apart, begun_apart
from ffl.diagnose.screen.drives import blocked
from ffl.diagnose.screen.followed import followed, strays
from ffl.diagnose.screen.kinds import (
    ABSOLUTE,
    AROUND,
    BLIND,
    INERTIAL,
    LEADING,
    OF_A_SCALE,
    POSITIVE,
)
from ffl.effects import EFFECTS, Effect, Motion
from ffl.effects.drift import SETTLES
from ffl.errors import InputError
from ffl.recordings.units import turn_in
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

PER_COLUMN = 8.0  # sum of squares that one more coefficient must take off (twice its likelihood)
VALLEYS = 3  # beside the best that a simulation looks into
NORM_FLOOR = 1e-6  # of the largest column: below it a column is nothing but rounding


Tables = dict[tuple[tuple[str, float], ...], Array]  # columns of one effect by what shapes them


class Screen:
    """First-order contributions of effects to y, whitened, beyond what `fit` explains; along the motion
    that its model makes, or that it makes in `along` (`followed.followed`): the machine's own.
    `wanted` (N,): what is to be explained; `slopes` (N, p): what the model's own numbers do to it."""

    believing = False  # whether the model's own numbers pay for leaving their nominal values

    def __init__(self, scene: Scene, fit: Fit, along: Scene | None = None) -> None:
        self.scene, self.fit, self.model = scene, fit, fit.model
        self.along = along
        self.setting = self.model.simulator
        self.passage = Passage(scene, self.model)
        self._motions: dict[tuple[str, float | None], list[Motion]] = {}
        self._others: Array | None = None
        self.slopes, self.wanted = fit.jacobian, fit.white
        if along is not None:
            left = along.residuals(self.model)
            assert left is not None  # followed to its end before
            self.slopes, self.wanted = self._slopes(along, left), self._led(along, left)
        if self.slopes.shape[1] and (along is not None or self.believing):
            self.basis, self._taken = believed(self.slopes, self.model)
        else:
            self.basis, self._taken = orthonormal(self.slopes), np.ones(())
        self.residual = self.beyond(self.wanted)

    def _slopes(self, along: Scene, left: Sequence[Array]) -> Array:
        """What the model's own numbers change in the whitened y along the motion, (N, p)."""
        return self.scene.whiten_stacked(jacobian(along, self.model, left))

    def _led(self, along: Scene, left: Sequence[Array]) -> Array:
        """What the linear loop answers to the force that leads there, and what that has `left`, (N,)."""
        forces = []
        for led, own in zip(along.trials, self.scene.trials, strict=True):
            assert led.load is not None  # that leads it
            forces.append(led.load if own.load is None else led.load - own.load)
        answered = self.through(Place("command"), [f[:, None] for f in forces])[:, 0]
        return answered + self.scene.whiten(left)

    def beyond(self, columns: Array) -> Array:
        """`columns`, (N,) or (N, k), beyond what the model's own freedom explains:
        (I + J C J')^(-1/2) columns, C the prior covariance of its numbers (infinite, unless believed)."""
        seen = self.basis.T @ columns
        out = columns - self.basis @ (self._taken * seen.T).T
        return out if self._others is None else out - self._others @ (self._others.T @ out)

    def beside(self, tables: Sequence[Array]) -> Screen:
        """The view beyond what columns of other effects, (N, k) each, explain as well."""
        other = copy.copy(self)
        other._others = orthonormal(self.beyond(np.hstack(list(tables))))
        other.residual = other.beyond(self.wanted)
        return other

    def foretold(self, left: Fit) -> Screen:
        """The same view of what a filter has `left` of y from sample to sample: to first order that answers
        a force as the whitened y does."""
        other = copy.copy(self)
        other.wanted, other.slopes = left.white, left.jacobian
        other.basis, other._taken = believed(left.jacobian, left.model)
        other.residual = other.beyond(left.white)
        return other

    # --- filters ---------------------------------------------------------------------------------

    def through(self, place: Place, columns: Sequence[Array]) -> Array:
        """Regressors of each recording (N_i, k) filtered to whitened y and stacked; of what a machine
        does its sensor shows what it `passes`, of what a sensor adds what comes last in it does."""
        passed = self._passed[place.port == "output"]
        return self.passage.through(place, columns, passed)

    @cached_property
    def _passed(self) -> tuple[list[Array] | None, list[Array] | None]:
        """What the model's sensor shows of a small change, (N,) of each recording: minus that where it
        is blind to the sign, nothing where it clips, more or less where its scale bends; None where all
        of it. Of a change of the motion, and of one that the sensor makes."""
        machine, _ = self.model.judged_on(self.scene.trials)
        blind = [(EFFECTS[s.name], s.parameters) for s in machine.acting]
        blind = [pair for pair in blind if pair[0].passes(pair[1], np.zeros(1)) is not None]
        if not blind:
            return None, None
        blind.sort(key=lambda pair: pair[0].order(pair[1]))
        speed = self.model.simulator.mechanics.place is not None
        motion, added = [], []
        for m in self.motions(Place("output", "sensor")):
            seen = m.v if speed else m.x
            motion.append(np.ones(len(seen)))
            added.append(np.ones(len(seen)))
            for effect, values in blind:
                share = effect.passes(values, seen)
                assert share is not None  # nor of zeros
                motion[-1] = motion[-1] * share
                if effect.order(values) > 0:
                    added[-1] = added[-1] * share
                seen = effect.shown(values, seen)
        return motion, added if any(effect.order(v) > 0 for effect, v in blind) else None

    # --- motion ----------------------------------------------------------------------------------

    def motions(self, place: Place, effect: Effect | None = None) -> list[Motion]:
        """Motion at the place, of a force mid-sample: it is held over one. What a drive makes of a command
        has it as recorded, as its model does."""
        side = "sensor" if place.port == "output" else place.side
        sent = effect is not None and is_drive(effect, self.scene.observed)
        key = (f"{place.port == 'force'}{sent}{side}", place.mass_ratio)
        if key not in self._motions:
            trials = (self.along or self.scene).trials
            self._motions[key] = [self._motion(trial, place, sent) for trial in trials]
        return self._motions[key]

    def _motion(self, trial: Trial, place: Place, sent: bool) -> Motion:
        key = ("sensor" if place.port == "output" else place.side, place.mass_ratio)
        run = self.model.simulate(trial, watch=[key])
        motion = run.motion(*key)
        if (sent or self.along is not None) and np.all(np.isfinite(trial.u)):
            motion = replace(motion, u=trial.u)
        if place.port == "output" and self.model.simulator.mechanics.place is not None:
            return replace(motion, x=run.y)  # a sensor of speed acts on the speed
        return motion.mid_sample if place.port == "force" else motion

    # --- judging ---------------------------------------------------------------------------------

    def gain(self, columns: Array, positive: bool = False) -> tuple[float, Array]:
        """(what the columns take off the residual's sum of squares, their coefficients; `positive`:
        none of them negative)."""
        beyond = self.beyond(columns)
        size = lengths(beyond)
        floor = NORM_FLOOR * np.maximum(lengths(columns), 1e-300)
        if np.any(size <= floor):
            return 0.0, np.zeros(columns.shape[1])
        if len(size) == 1:  # most of the grid: no factorisation needed
            coefficients: Array = np.array([beyond[:, 0] @ self.residual]) / size
            if positive and coefficients[0] < 0:
                return 0.0, np.zeros(1)
            return float(coefficients[0] ** 2), coefficients / size
        r, target = triangle(beyond, self.residual)
        r = r / size
        if np.abs(np.diag(r)).min() < 1e-7:
            return 0.0, np.zeros(columns.shape[1])
        coefficients = np.linalg.solve(r, target)
        if positive and np.any(coefficients < 0):
            coefficients, left = scipy.optimize.nnls(r, target)
            return float(target @ target - left**2), coefficients / size
        return float(target @ target), coefficients / size

    def candidates(self, names: Sequence[str] | None = None) -> list[Candidate]:
        """Best starting point of every effect at every place, best first."""
        return catalogue([(self, EFFECTS if names is None else names)])[0]

    def places(self, effect: Effect) -> list[Place]:
        mechanics = self.model.simulator.mechanics
        if effect.port == "flow":
            return flow_places(self.model, effect)
        if effect.of_processes and not self.model.base.is_process:
            return []
        if effect.of_angles and turn_in(self.model.base.plant.output_unit) is None:
            return []
        if effect.port == "command" and "position" in effect.depends_on:
            return drive_places(self.model)
        if effect.name in LEADING and (mechanics.place is not None or not mechanics.modes):
            return []  # the acceleration of what is measured as a speed is no motion of a point
        if effect.name in OF_A_SCALE and mechanics.place is not None:
            return []
        if effect.port != "force":
            return [Place(effect.port)]
        if effect.needs_mass and not mechanics.modes:
            return []  # one lag moves no mass
        if effect.name in INERTIAL and self.model.base.is_process:
            return []
        if effect.name == "mass_change" and mass_is_corrected(self.model):
            return []
        if mechanics.place is not None and effect.name in ABSOLUTE:
            known = all(trial.place is not None for trial in self.scene.trials)
            if not (known and effect.name == AROUND):
                return []  # the integral of a speed begins anew with every recording
        out = places_of(self.model) + behind_a_mode(self.model, effect.name)
        kept = [p for p in out if p.side in effect.sides]
        if len(kept) > 1 and effect.default_side != "sensor":  # a drive's force is none of its
            kept = [p for p in kept if p.side != "sensor"]
        if set(effect.depends_on) <= BLIND:
            kept = distinct_forces(self.model, kept)
        return kept or [Place("force", effect.default_side)]

    def best(self, effect: Effect, place: Place, tables: Tables | None = None) -> Candidate | None:
        """The best of the effect's grid at this place; `tables` of columns are taken from there, and
        left there for other views of the same motion."""
        from ffl.diagnose.screen.scan import periods

        motions = self.motions(place, effect)
        if effect.scan:
            grid: Sequence[Mapping[str, float]] = periods(self, effect, place)
        else:
            turn = turn_in(self.model.base.plant.output_unit)
            grid = effect.grid(_joined(motions, turn))
        tops: dict[float, Candidate] = {}  # by the number that has valleys
        for nonlinear in grid:
            columns = self._shared(effect, place, nonlinear, tables)
            gain, coefficients = self.gain(columns, effect.name in POSITIVE)
            if not gain > 0.0:  # nor where a column is no number
                continue
            if effect.fixed_amount:  # it is there as it is
                gain *= 1.0 - (1.0 - 1.0 / coefficients[0]) ** 2
            worth = gain - PER_COLUMN * columns.shape[1]
            at = nonlinear.get(effect.valleys, 0.0)
            rival = tops.get(at)
            if rival is not None and worth <= rival.gain - PER_COLUMN * rival.freedom:
                continue
            if effect.fixed_amount and not 0.2 < coefficients[0] < 5.0:
                continue
            spec = spec_of(effect, place, coefficients, nonlinear)
            freedom = columns.shape[1]
            found = Candidate(spec, gain, freedom, place, self.fit, nonlinear)
            if not blocked(self, [found], [coefficients]):
                tops[at] = found
        return _deepest(tops) if tops else None

    def _shared(
        self, effect: Effect, place: Place, nonlinear: Mapping[str, float], tables: Tables | None
    ) -> Array:
        if tables is None:
            return self._table(effect, place, nonlinear)
        key = tuple(nonlinear.items())
        if key not in tables:
            tables[key] = self._table(effect, place, nonlinear)
        return tables[key]

    def table_of(self, c: Candidate) -> Array:
        """The candidate's columns, (N, freedom), in whitened y."""
        return self._table(EFFECTS[c.spec.name], c.place, c.nonlinear)

    def _table(self, effect: Effect, place: Place, nonlinear: Mapping[str, float]) -> Array:
        motions = self.motions(place, effect)
        if place.port == "flow":
            columns = self._simulated(EffectSpec(effect.name, nonlinear, place.options))
        else:
            tables = [self.columns_of(effect, m, nonlinear, place) for m in motions]
            if self.scene.free_clocks and nonlinear.get("kind") == SETTLES:
                goes_on = [t.goes_on for t in self.scene.trials]
                tables = begun_apart(tables, goes_on, 1.0 / self.model.simulator.force_per_input)
            columns = self.through(place, tables)
        if effect.scan == "time" and self.scene.free_clocks:
            columns = apart(columns, [len(m.t) for m in motions])
        return columns

    def _simulated(self, spec: EffectSpec) -> Array:
        """What `spec` changes in the whitened y by simulation, (N, 1)."""
        before, after = (
            self.scene.residuals(m) for m in (self.model, self.model.with_effect(spec))
        )
        if before is None or after is None:
            return np.zeros((self.scene.samples, 1))
        return self.scene.whiten([a - b for a, b in zip(before, after, strict=True)])[:, None]

    def columns_of(
        self, effect: Effect, motion: Motion, nonlinear: Mapping[str, float], place: Place
    ) -> Array:
        columns = effect.regressors(motion, **nonlinear)
        if place.port == "force":
            columns = columns / self.model.simulator.force_per_input
        return columns


def _deepest(tops: Mapping[float, Candidate]) -> Candidate:
    """The best of the candidates along a number, (number: candidate), with those of other valleys."""
    row = [tops[at] for at in sorted(tops)]
    gains = [-np.inf, *(c.gain for c in row), -np.inf]
    peaks = [c for k, c in enumerate(row) if gains[k] <= c.gain >= gains[k + 2]]
    best, *others = sorted(peaks, key=lambda c: PER_COLUMN * c.freedom - c.gain)
    return replace(best, valleys=tuple(c.spec for c in others[:VALLEYS]))


def catalogue(wanted: Sequence[tuple[Screen, Collection[str]]]) -> list[list[Candidate]]:
    """`Screen.candidates` of several views, each with the names it is asked for. They are of one fit along
    one motion (`Screen.beside`), so that columns are computed once for all."""
    first = wanted[0][0]
    asked = [e for name, e in EFFECTS.items() if any(name in names for _, names in wanted)]
    entries = [(effect, place) for effect in asked for place in first.places(effect)]
    for place in dict.fromkeys(place for _, place in entries):
        with suppress(InputError):  # simulated once, before threads ask for it
            first.motions(place)

    def best(entry: tuple[Effect, Place]) -> list[Candidate | None]:
        effect, place = entry
        tables: Tables | None = {} if len(wanted) > 1 else None
        out: list[Candidate | None] = []
        for view, names in wanted:
            out.append(None)
            if effect.name in names:
                with suppress(InputError):
                    out[-1] = view.best(effect, place, tables)
        return out

    found = each(best, entries)
    return [
        sorted((c for c in own if c is not None), key=lambda c: -c.gain)
        for own in ([row[k] for row in found] for k in range(len(wanted)))
    ]


def as_measured(scene: Scene, fit: Fit) -> Screen | None:
    """The view beside `fit` along the motion that was measured; None where its own is much the same, or
    an observer leads it there by itself."""
    if not strays(scene, fit):
        return None
    along = followed(scene, fit.model)
    return None if along is None else Screen(scene, fit, along)


def _joined(motions: Sequence[Motion], turn: float | None) -> Motion:
    """All recordings as one, for grids by range and quantile."""
    names = ("t", "r", "u", "x", "v", "a")
    t, r, u, x, v, a = (np.concatenate([getattr(m, name) for m in motions]) for name in names)
    return replace(motions[0], turn=turn or motions[0].turn, t=t, r=r, u=u, x=x, v=v, a=a)
