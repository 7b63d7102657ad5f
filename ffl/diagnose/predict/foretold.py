"""A hypothesis foretold from sample to sample, y and the command as measured, and fitted to that.

Where two free runs of one machine part, or noise moves it as much as the command does, a filter that keeps
the state at what was measured says more than a simulation. Its innovations e_t of variance S_t have

    log p(y) = -(sum log(2 pi S_t) + e_t^2/S_t)/2,

with all noise scaled to what is left.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import Fit, surprise
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

ROUNDS, TRIES = 8, 5  # of a fit, and damped steps of each
FIRST = 2  # rounds in which one of several starts shows what it is worth
STILL = 2.0  # gain of a round in the sum of squares below which the next one is spared
Told = TypeVar("Told", bound="Foretold")


@dataclass(frozen=True)
class Foretold:
    """A model, and the noise that it is foretold under."""

    model: Model
    noise: Noise

    @property
    def theta(self) -> Array:
        return self.model.theta.copy()

    def at(self, theta: Array) -> Self:
        return replace(self, model=self.model.at(theta))

    @property
    @abstractmethod
    def steps(self) -> Array:
        """Differences for derivatives, by coordinate."""

    @abstractmethod
    def predict(self, trials: Sequence[Trial]) -> tuple[Array, Array] | None:
        """(scaled innovations, logarithms of their scales) of all recordings; None: no such plant."""

    def scaled(self, trials: Sequence[Trial]) -> tuple[float, float]:
        """(log-likelihood with all noise times the factor that suits it best, the factor)."""
        found = self.predict(trials)
        if found is None:
            return -np.inf, 1.0
        white, logs = found
        square = float(np.mean(white**2))
        value = -0.5 * len(white) * (1.0 + np.log(square)) - logs.sum()
        return float(value), float(np.sqrt(square))

    def in_its_noise(self, trials: Sequence[Trial]) -> tuple[Self, float]:
        """(the same with all noise times the factor that suits `trials`, its log-likelihood there)."""
        fitted, factor = self.scaled(trials)
        return replace(self, noise=self.noise.scaled(factor)), fitted

    def columns(self, trials: Sequence[Trial], white: Array, fixed: Collection[int] = ()) -> Array:
        """Derivatives of the scaled prediction `white` by theta, (N, p); none by what is `fixed`."""
        found = np.zeros((len(white), len(self.theta)))
        for k, step, there in self.stepped(trials, fixed):
            found[:, k] = (white - there[0]) / step
        return found

    def stepped(
        self, trials: Sequence[Trial], fixed: Collection[int] = ()
    ) -> list[tuple[int, float, tuple[Array, Array]]]:
        """(coordinate, its step, what is predicted one step on) for all that are not `fixed`, but for what
        is no plant there."""
        moves = [(k, step) for k, step in enumerate(self.steps) if k not in fixed]

        def moved(move: tuple[int, float]) -> tuple[Array, Array] | None:
            theta = self.theta
            theta[move[0]] += move[1]
            return self.at(theta).predict(trials)

        found = each(moved, moves)
        return [(*m, there) for m, there in zip(moves, found, strict=True) if there is not None]

    def linearised(  # type: ignore[no-untyped-def]
        self,
        trials: Sequence[Trial],
        found: tuple[Array, Array],
        factor: float,
        fixed: Collection[int] = (),
    ):
        """(what is to be made small, its derivatives by theta but for what is `fixed`), with all noise
        times `factor`."""
        return found[0] / factor, self.columns(trials, found[0], fixed) / factor

    def fit(self, trials: Sequence[Trial]) -> Fit | None:
        """As it stands; None: no such plant."""
        foretold = self.predict(trials)
        if foretold is None:
            return None
        columns = self.columns(trials, foretold[0])
        return Fit(self.model, foretold[0], columns, columns, "converged")

    def judged(
        self, scene: Scene, held: Scene, fitted: float, louder: float = 1.0
    ) -> Judged | None:
        """As a hypothesis of the contest, under its own noise: of log-likelihood `fitted`, what it leaves
        of the held-out recordings told as so many times `louder`; None: no such plant."""
        fit, ahead = self.fit(scene.trials), self.predict(held.trials)
        if fit is None or ahead is None:
            return None
        own, judged = replace(scene, noise=self.noise), self.scaled(held.trials)[0]
        return Judged(fit, own, fitted, judged, ahead[0] * louder, held, predicted=True)

    def worth(self, trials: Sequence[Trial]) -> float:
        """What a search makes most."""
        return self.scaled(trials)[0] - surprise(self.model)


def best_of(starts: Sequence[Told], trials: Sequence[Trial], short: Sequence[Trial]) -> Told:
    """What the best of several `starts` comes to: the one that is ahead after two rounds on the `short`
    recordings goes on with all of them."""
    if len(starts) > 1:
        begun = [refitted(start, short, rounds=FIRST) for start in starts]
        starts = [max(begun, key=lambda told: told.worth(short))]
    return refitted(starts[0], trials)


def of_others(model: Model) -> list[int]:
    """Which coordinates belong to anything but the last effect."""
    last = len(model.effects) - 1
    return [k for k, c in enumerate(model.coordinates) if c.effect != last]


def refitted(
    point: Told, trials: Sequence[Trial], fixed: Collection[int] = (), rounds: int = ROUNDS
) -> Told:
    """Levenberg and Marquardt on the scaled innovations, all noise scaled to what is left; numbers `fixed`
    stay."""
    doubts = np.array([c.doubt for c in point.model.coordinates])
    point = point.at(point.theta)  # within the bounds of every number
    damping, worth = 1e-2, point.worth(trials)
    for _ in range(rounds):
        found = point.predict(trials)
        if found is None:
            return point
        theta, factor = point.theta, float(np.sqrt(np.mean(found[0] ** 2)))
        white, j = point.linearised(trials, found, factor, fixed)
        still = ~np.any(j, axis=0)  # what nothing shows as well
        pull = np.sqrt(3.0 / (2.0 + (theta / doubts) ** 2)) / doubts
        size = np.where(still, 1.0, np.maximum(np.linalg.norm(j, axis=0), 1e-300))
        before = worth
        for _ in range(TRIES):
            table = np.vstack([j, np.diag(pull), np.sqrt(damping) * np.diag(size)])
            wanted = np.concatenate([white, -pull * theta, np.zeros(len(theta))])
            step = np.linalg.lstsq(table / size, wanted, rcond=None)[0] / size
            step[still] = 0.0
            tried = point.at(theta + step)
            value = tried.worth(trials)
            if value > worth:
                point, worth, damping = tried, value, 0.2 * damping
                break
            damping = max(10.0 * damping, 1e-2)
        if worth - before < 0.5 * STILL:
            break
    return point
