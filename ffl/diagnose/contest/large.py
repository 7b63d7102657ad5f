"""Large effects on a machine whose linear model is a few per cent off everywhere: named one by one
while the whole linear part is calibrated beside them.

Whitening shows what feedback hides, and weighs down what is slow and large. On a machine with many
modes friction of a fifth of the motor's force leaves an error a thousand times the noise; the whitened
fit of the linear model alone takes it up by moving every mode, and from there the friction is not
found any more. In the free-running error as it is, the same friction is most of what there is, and
each effect found and calibrated together with zeros and poles lets the next one stand out. The linear
part starts anew from the model in every round: kept from the round before it would hold on to what it
took up of effects that had no name yet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffl.diagnose.contest.calibrate import calibrate, free_running
from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.judging import raw_error
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit
from ffl.diagnose.hypothesis.model import Base, Model
from ffl.diagnose.hypothesis.places import POINT, Place, placed, places_of
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.trials import extent, prepare
from ffl.diagnose.screen.candidate import Candidate
from ffl.diagnose.screen.screen import Screen
from ffl.diagnose.screen.simulated_scan import cogging_of
from ffl.effects import EFFECTS
from ffl.effects.motion import Extent
from ffl.errors import InputError
from ffl.machines import Simulator
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec, Plant

WORTH = 0.64  # of (RMS fitted) x (RMS held out): what one more effect must bring it below
BETTER = 0.9  # of the same: what another place, period or form must
DECISIVE = 0.01  # of the same: a cogging that does this needs no rivals
QUIET = 1.5  # times the RMS that the plant file's noise leaves: below it nothing is missing
ENTRANTS = 6  # effects of a round that are fitted; the three leading ones at every place
FINALISTS = 3  # of them, fitted on
GLIMPSE = 2  # steps of an entrant's fit
MOST = 4  # effects
BRANCHES = 2  # other ways that are tried
WAVES = 6  # periods of a cogging that are fitted
FORMS = {  # of one physics: the plain one is named first, the others take its place in the end
    "coulomb_friction": sorted(DRY - {"coulomb_friction", "position_dependent_friction"}),
    "viscous_friction": ["quadratic_drag"],
    "linear_stiffness": ["hardening_spring"],
}
# Through a loop a ripple of the scale bends like any force along the position.
SENSOR = {"encoder_ripple"}
PLIABLE = SENSOR | {"position_dependent_friction", "drift", "periodic_disturbance", "backlash"}
BARRED = PLIABLE.union(*FORMS.values())  # no first name


@dataclass(frozen=True)
class Tried:
    """A calibrated plant with its RMS of the free-running error, fitted and held out (output units)."""

    plant: Plant
    fitted: float
    held_out: float

    @property
    def cost(self) -> float:
        return self.fitted * self.held_out

    @property
    def names(self) -> str:
        return " + ".join(e.name for e in self.plant.effects) or "linear part alone"


@dataclass(frozen=True)
class LargeEffects:
    """`plant` calibrated with the effects named; `before` the model as given, `linear` with nothing
    but its linear part calibrated, `rounds` what was fitted in each of them, best first."""

    plant: Plant
    before: Tried
    linear: Tried
    after: Tried
    rounds: tuple[tuple[Tried, ...], ...]


@dataclass(frozen=True)
class PlainScene(Scene):
    """A scene that weighs the error as it is, divided by its RMS `left`."""

    left: float = 1.0

    @cached_property
    def whiteners(self) -> tuple[Whitener, ...]:
        zero = np.zeros(1)
        plain = Whitener(np.zeros((1, 1)), zero, zero[None], np.array([self.left]))
        return tuple(plain for _ in self.trials)


def large_effects(
    model: Plant,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Callable[[str], None] | None = None,
) -> LargeEffects:
    """Forward selection on the free-running error, then substitution of periods, places and forms of
    friction, then elimination; both sets of recordings begin at rest.

    The first effect must beat what the linear part alone reaches when it is calibrated; without one,
    that is the answer. Raises what `calibrate` raises. Cost: some thousand simulations a round.
    """
    desk = _Desk(model, recordings, validation, progress or (lambda line: None))
    before = desk.measured(model)
    linear = desk.measured(calibrate(model, recordings).plant)
    desk = replace(desk, linear=linear)
    desk.tell(linear)
    rounds: list[tuple[Tried, ...]] = []
    standing = desk.forward(linear, rounds)
    for other in _branches(rounds):
        if not desk.mismatch(standing):
            break
        desk.say(f"once more from {other.names}")
        standing = min(standing, desk.forward(other, rounds), key=lambda t: t.cost)
    if standing.plant.effects:
        standing = desk.pruned(standing)
        for k in range(len(standing.plant.effects)):
            standing = desk.placed(standing, k)
        standing = desk.formed(standing)
        standing = min(desk.calibrated(standing.plant), standing, key=lambda t: t.cost)
        desk.tell(standing)
    return LargeEffects(standing.plant, before, linear, standing, tuple(rounds))


@dataclass(frozen=True)
class _Desk:
    model: Plant
    recordings: Sequence[Recording]
    validation: Sequence[Recording]
    say: Callable[[str], None]
    linear: Tried | None = None

    def forward(self, standing: Tried, rounds: list[tuple[Tried, ...]]) -> Tried:
        """One effect after the other, until nothing is left or nothing brings more."""
        while len(standing.plant.effects) < MOST and self.mismatch(standing):
            known = standing.plant if standing.plant.effects else self.model
            tried = self.round(replace(standing, plant=known))
            rounds.append(tuple(tried))
            if not tried or tried[0].cost > BETTER * standing.cost:
                break
            best = tried[0] if known.effects else self.placed(tried[0], 0)
            standing = self.scanned_again(best)
            self.tell(standing)
            if not self.mismatch(whole := self.calibrated(standing.plant)):
                standing = whole
        return standing

    def tell(self, tried: Tried, indent: str = "") -> None:
        sides = "/".join(str(e.options.get("side", "")) for e in tried.plant.effects)
        self.say(
            f"{indent}{tried.names} {sides}: {tried.fitted:.3g}, held out {tried.held_out:.3g}"
        )

    def measured(self, plant: Plant) -> Tried:
        rms = [
            float(np.sqrt(np.mean(free_running(plant, r) ** 2)))
            for r in (self.recordings, self.validation)
        ]
        return Tried(plant, *rms)

    def mismatch(self, standing: Tried) -> bool:
        """More than noise is left, or as much as without any effect: about detents noise may make a
        machine with the wrong cogging do anything, and that explains nothing."""
        linear = self.linear if standing.plant.effects else None
        if linear is not None and standing.cost > WORTH * linear.cost:
            return True
        return standing.fitted > QUIET * noise_left(standing.plant, self.recordings)

    def calibrated(self, plant: Plant) -> Tried:
        return self.measured(calibrate(plant, self.recordings).plant)

    def fitted(self, effects: Sequence[EffectSpec], rounds: int = 6) -> Tried | None:
        """The model with these effects, all numbers fitted once; None where it cannot run, or where an
        effect then has no numbers of its physics. (A preloaded spring as wide as the travel: a cable.)"""
        start = replace(self.model, effects=tuple(effects))
        try:
            plant = calibrate(start, self.recordings, 1, rounds).plant
            able = all(EFFECTS[e.name].credible(e, self.reach) for e in plant.effects)
            return self.measured(plant) if able else None
        except InputError:
            return None

    @cached_property
    def reach(self) -> Extent:
        """Of the motion that is fitted."""
        base = Base.of(self.model, max(float(np.ptp(r.y)) for r in self.recordings))
        trials = [prepare(base.simulator, r, 1e-9) for r in self.recordings]
        return extent(trials, base.travel, self.model.output_unit)

    def best(self, each: Iterable[Sequence[EffectSpec]], rounds: int = 6) -> list[Tried]:
        """Those of `each` that can run, best first; one that leaves nothing but noise ends it."""
        done: list[Tried] = []
        for effects in each:
            tried = self.fitted(effects, rounds)
            if tried is not None:
                done.append(tried)
                if not self.mismatch(tried):
                    break
        return sorted(done, key=lambda t: t.cost)

    def round(self, standing: Tried) -> list[Tried]:
        """The most promising plants with one more effect; a force acts where the first one does."""
        known = standing.plant
        barred = {e.name for e in known.effects} | BARRED
        at = _point(known)
        waves: list[Tried] = []
        if at is not None and "cogging" not in barred:
            waves = self.best([(*known.effects, w) for w in self.waves(known)])
            barred = barred | {"cogging"}
        finals = waves
        if not waves or waves[0].cost > DECISIVE * standing.cost:
            seen = [
                c
                for c in self.screen(known).candidates()
                if c.spec.name not in barred
                and (at is None or c.place.port != "force" or placed(c.spec) == at)
            ]
            leading: dict[str, Tried] = {}
            for t in self.best([(*known.effects, c.spec) for c in _entrants(seen)], GLIMPSE):
                leading.setdefault(t.plant.effects[-1].name, t)
            finals += self.best([t.plant.effects for t in list(leading.values())[:FINALISTS]])
        finals.sort(key=lambda t: t.cost)
        for t in finals:
            self.tell(t, "  ")
        return finals

    def screen(self, known: Plant) -> Screen:
        """First-order view of what `known` leaves, beside the freedom of its linear part."""
        base = Base.of(replace(known, effects=()), max(float(np.ptp(r.y)) for r in self.recordings))
        trials = tuple(prepare(base.simulator, r, 1e-9) for r in self.recordings)
        model = Model(base, {}, known.effects)
        scene = Scene(known.loop, trials, Noise(1.0, 1.0))
        left = max(np.sqrt(raw_error(scene, model) / scene.samples), 1e-300)
        plain = PlainScene(scene.loop, trials, scene.noise, left=float(left))
        return Screen(plain, fit(plain, model, rounds=0))

    def places(self) -> list[Place]:
        base = Base.of(self.model, max(float(np.ptp(r.y)) for r in self.recordings))
        return places_of(Model(base))

    def waves(self, known: Plant) -> list[EffectSpec]:
        """Cogging where the first named force acts."""
        return cogging_of(known, self.recordings, _point(known) or {})[:WAVES]

    def scanned_again(self, tried: Tried) -> Tried:
        """Cogging looked for once more beside what has come in since."""
        effects = tried.plant.effects
        for k, old in enumerate(effects[:-1]):
            if old.name != "cogging":
                continue
            others = (*effects[:k], *effects[k + 1 :])
            found = self.waves(replace(tried.plant, effects=others))
            tried = self.better(tried, [(*others, e) for e in found])
        return tried

    def placed(self, tried: Tried, k: int) -> Tried:
        """Effect `k` tried at the other places where a force may act."""
        effects = tried.plant.effects
        old, effect = effects[k], EFFECTS[effects[k].name]
        if effect.port != "force" or not self.mismatch(tried):
            return tried
        free = {n: v for n, v in old.options.items() if n not in POINT}
        specs = [
            replace(old, options={**free, **p.options})
            for p in self.places()
            if p.side in effect.sides and p.options != placed(old)
        ]
        return self.better(tried, [(*effects[:k], s, *effects[k + 1 :]) for s in specs])

    def formed(self, tried: Tried) -> Tried:
        """Every effect in the other forms of its physics, at its place."""
        for k, old in enumerate(tried.plant.effects):
            effects = tried.plant.effects
            others = (*effects[:k], *effects[k + 1 :])
            if old.name in FORMS and self.mismatch(tried):
                seen = self.screen(replace(tried.plant, effects=others)).candidates(FORMS[old.name])
                found = [c.spec for c in seen if placed(c.spec) == placed(old)]
                each = [(*effects[:k], s, *effects[k + 1 :]) for s in found]
                tried = self.better(tried, each, WORTH)
        return tried

    def better(
        self, tried: Tried, each: Sequence[Sequence[EffectSpec]], worth: float = BETTER
    ) -> Tried:
        for other in self.best(each)[:1]:
            if other.cost < worth * tried.cost:
                self.tell(other, "  instead: ")
                return other
        return tried

    def pruned(self, tried: Tried) -> Tried:
        """Without the effects that do not earn their place beside the others."""
        for old in tried.plant.effects:
            others = [e for e in tried.plant.effects if e is not old and e.name != old.name]
            if not others:
                break
            without = self.fitted(others)
            if without is not None and tried.cost > WORTH * without.cost:
                self.tell(without, f"  without {old.name}: ")
                tried = without
        return tried


def _branches(rounds: Sequence[Sequence[Tried]]) -> list[Tried]:
    """What came next in the second round, the first of every other name: where the way of the best
    ends with something left, the right one may begin there."""
    first: dict[str, Tried] = {}
    for tried in rounds[1] if len(rounds) > 1 else ():
        first.setdefault(tried.plant.effects[-1].name, tried)
    return list(first.values())[1 : 1 + BRANCHES]


def _point(plant: Plant) -> dict[str, Any] | None:
    """Where the first force among the effects acts; None: there is none."""
    forces = [e for e in plant.effects if EFFECTS[e.name].port == "force"]
    return placed(forces[0]) if forces else None


def noise_left(plant: Plant, recordings: Sequence[Recording]) -> float:
    """RMS of what the noise of the plant file leaves in y, with its effects acting; 0: none stated."""
    m = plant.machine
    if not (m.sensor_noise or m.force_noise):
        return 0.0
    simulator, rng, total = Simulator(plant), np.random.default_rng(0), 0.0
    for r in recordings:
        force, sensor = rng.standard_normal((2, len(r)))
        start = simulator.at_rest(float(r.r[0]))
        loud, still = (
            simulator.run(
                plant.effects,
                r.r,
                r.f,
                force=share * m.force_noise * force,
                noise=share * m.sensor_noise * sensor,
                start=start,
            ).y
            for share in (1.0, 0.0)
        )
        total += float(np.sum((loud - still) ** 2))
    return float(np.sqrt(total / sum(len(r) for r in recordings)))


def _entrants(seen: Sequence[Candidate]) -> list[Candidate]:
    """The best of every effect, and the leading three at every place; `seen` is sorted."""
    best: dict[tuple[object, ...], Candidate] = {}
    for c in seen:
        best.setdefault((c.spec.name, c.place), c)
    first: dict[str, Candidate] = {}
    for c in best.values():
        first.setdefault(c.spec.name, c)
    chosen = list(first.values())[:ENTRANTS]
    leading = {c.spec.name for c in chosen[:3]}
    return chosen + [c for c in best.values() if c.spec.name in leading and c not in chosen]
