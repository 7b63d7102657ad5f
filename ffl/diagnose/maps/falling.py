"""A limit of the command that falls with speed, as of a supply's voltage, where a fixed one was named.

    |u| <= max(0, limit - fall |v|)

A fixed limit stands where the falling one is lowest in the recordings, and takes enough of the mismatch to
pass for the physics. The maps are linear in their numbers and this law is not: it is fitted by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place, drive_places
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.freeform import judged
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.diagnose.maps.grids import ranges_of
from ffl.diagnose.maps.mapped import FALLING
from ffl.diagnose.maps.terms import TERMS
from ffl.diagnose.noise.least import least_noise
from ffl.effects import EFFECTS, Motion
from ffl.effects.modal import is_speed
from ffl.systems.state_space import Array

NAME = "saturation"
STARTS = (0.0, 0.3, 0.6)  # share of the limit that is lost at the largest speed
SIZE = 0.1  # of the limit, and of what it loses: what one is to a step
MOST_GROWN = 100.0  # of SIZE: logarithm of the most that a limit may be of the one named
STEP = 1e-4  # of what is one, between two simulations
MOST = 60  # runs of a fit, those for slopes apart
RUNAWAY = 1e6  # whitened residual in place of a run that leaves all bounds


@dataclass(frozen=True)
class FallingLimit(Part):
    """`coefficients`: limit and fall, units of the command and of it per speed."""

    def signal(self, motion: Motion) -> Array:
        """What is cut off the command, (N,), with its sign."""
        limit, fall = self.coefficients
        allowed = np.maximum(limit - fall * np.abs(motion.v), 0.0)
        return np.clip(motion.u, -allowed, allowed) - motion.u


TERM = replace(
    next(term for term in TERMS if term.name == "limit by speed"),
    side="sensor", kind=FALLING, levels=lambda ranges: np.zeros(0),
)  # fmt: skip


def falling_limits(
    scene: Scene, held: Scene | None, standing: Model, nominal: Model
) -> list[FreeForm]:
    """The falling limit in place of the fixed one that is named: alone, and beside the other names where
    there are any; none where no limit stands, or not by itself at the command."""
    at_command = [k for k, e in enumerate(standing.effects) if EFFECTS[e.name].port == "command"]
    if [standing.effects[k].name for k in at_command] != [NAME]:
        return []
    limit = float(standing.effects[at_command[0]].parameters["limit"])
    others = standing.without(at_command[0])
    out = []
    for base in [nominal, others] if others.effects else [nominal]:
        tried = [_fitted(scene, held, base, place, limit) for place in _felt(base)]
        if found := [one for one in tried if one is not None]:
            out.append(min(found, key=lambda one: scene.cost(one.free)))
    return out


def law(free: FreeModel) -> Formula:
    """The falling limit in words."""
    limit, fall = free.parts[0].coefficients
    plant = free.model.base.plant
    place = plant.output_unit or "output"
    speed = place if is_speed(place) else f"{place}/s"
    unit = f" {plant.input_unit}" if plant.input_unit else ""
    said = f"|command| <= {limit:.4g}{unit} - {fall:.4g} |velocity| (velocity in {speed})"
    return Formula(said, None, None, 1.0)


def _felt(base: Model) -> list[Place]:
    """Where the drive may feel the speed: as measured, and where it pushes."""
    places = drive_places(base)
    if len(base.simulator.mechanics.modes) == 2:
        places.append(Place("command", "motor"))
    return places


def _fitted(
    scene: Scene, held: Scene | None, base: Model, place: Place, limit: float
) -> FreeForm | None:
    """Least squares under the least noise that is left, the model's numbers believed as they are."""
    runs = [base.attempt(trial) for trial in scene.trials]
    motions = [run.motion("sensor", None) for run in runs if run is not None]
    if len(motions) < len(runs):
        return None
    ranges = ranges_of(motions)
    top = max(abs(v) for v in ranges["v"])
    if not top > 0.0:
        return None
    blank = FreeModel(base, (FallingLimit(TERM, place, np.array([limit, 0.0]), ranges),))
    doubts = np.array([c.doubt for c in base.coordinates])
    size = np.append([SIZE, SIZE], np.where(np.isfinite(doubts), doubts, 1.0))

    def free_at(numbers: Array) -> FreeModel:
        grown, share, *own = (numbers - 1.0) * size
        most = limit * np.exp(grown)
        part = replace(blank.parts[0], coefficients=np.array([most, share * most / top]))
        return replace(blank.at(base.theta + np.array(own)), parts=(part,))

    def left(numbers: Array, quiet: Scene) -> Array:
        free = free_at(numbers)
        residuals = quiet.residuals(free)
        white = np.full(quiet.samples, RUNAWAY) if residuals is None else quiet.whiten(residuals)
        return np.append(white, free.theta / doubts)

    free = np.full(len(doubts), np.inf)
    bounds = np.append([1.0 - MOST_GROWN, 1.0], -free), np.append([1.0 + MOST_GROWN, np.inf], free)
    best: tuple[float, FreeModel, Scene] | None = None
    for share in STARTS:
        quiet, numbers = scene, np.ones(len(size))
        # The fixed one was found between the most and the least that this one leaves.
        numbers[:2] += np.array([-np.log(1.0 - 0.5 * share), share]) / size[:2]
        for _ in range(2):  # under the noise that the names left, then under less
            numbers = scipy.optimize.least_squares(
                left, numbers, args=(quiet,), diff_step=STEP, max_nfev=MOST,
                bounds=bounds,
            ).x  # fmt: skip
            residuals = quiet.residuals(free_at(numbers))
            if residuals is None:
                break
            quiet = replace(quiet, noise=least_noise(quiet, base, residuals))
        cost = scene.cost(free_at(numbers))
        if best is None or cost < best[0]:
            best = cost, free_at(numbers), quiet
    return None if best is None else judged(best[2], held, best[1], 0.0)
