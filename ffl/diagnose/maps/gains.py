"""What maps gain over names: by likelihood, on recordings fitted and held out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.earning import promised
from ffl.diagnose.contest.judging import OPEN
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.amounts import LINE, sizes
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.maps.choosing import FAR
from ffl.diagnose.maps.form import FreeForm, held_gain
from ffl.diagnose.maps.freemodel import FreeModel
from ffl.diagnose.maps.retold import STRAIGHT, from_there
from ffl.diagnose.noise.slow import in_own_noise as own_noise
from ffl.diagnose.recorded.where import phrase
from ffl.effects import EFFECTS

EVEN = 3.0  # log-likelihood: what is behind by less is not behind
MARGIN = 20.0  # log-likelihood by which maps must beat names, fitted and held out alike
BENT = 0.3  # of such a map: what may lie beside a straight line
NEARLY = 0.95  # share of the mismatch from which names that maps beat are kept as partly right


def gains_of(
    scene: Scene, held: Scene | None, standing: Model, nominal: Model, alone: FreeForm
) -> tuple[float, float, float]:
    """(fitted, held out) log-likelihood that the maps gain over the names, under the maps' noise, and what
    the held-out recordings would bring in the mean over the same rival (`promise`). What these gain by
    corrections that the fitted ones leave open, or get wrong, is no map's."""
    quiet = scene.like(alone.scene)
    left = quiet.residuals(standing)
    if left is None:
        return np.inf, np.inf, np.inf
    all_of_it = np.ones(len(alone.white), bool)
    fitted = held_gain(quiet.whiten(left), alone.white, all_of_it)
    if held is None or not held.trials:
        return fitted, fitted, np.inf
    judged, bare = held.like(alone.scene), alone.free.model
    rivals = [standing]
    if not standing.effects:
        rivals.append(nominal)
        if 0.5 * (quiet.cost(bare) - quiet.cost(standing)) <= OPEN:
            rivals.append(bare)
    gained = []
    for rival in rivals:
        left = judged.residuals(rival)
        white = np.full(len(alone.held_white), np.inf)
        if left is not None:
            white = judged.judge(left, alone.known)
        ahead = held_gain(white, alone.held_white, alone.known)
        gained.append((ahead, promised(white, alone.held_white, alone.known)))
    return (fitted, *min(gained))


def left_alone(beside: FreeForm, nominal: Model) -> FreeForm | None:
    """The maps that were found `beside` names, with no names: the linear model from where it ended up
    there. (Alone in the model as it is stated nothing else bends but its numbers: with the damping of a
    motor that fades with heat at -22 times the stated one no map took anything off.)"""
    corrections = {**nominal.corrections, **beside.free.model.corrections}
    return from_there(beside, FreeModel(replace(nominal, corrections=corrections), beside.parts))


def in_own_noise(scene: Scene, standing: Model, alone: FreeForm) -> float:
    """Log-likelihood that the maps gain where all that either leaves is noise of any colour. (Slow force
    noise is no map: one of the position took 0.3 % off it, 40 nats under white noise and -62 under its own;
    maps of what was missing gain 150 to 1,100.)"""
    without = own_noise(scene.like(alone.scene), standing)
    return np.inf if without == -np.inf else own_noise(alone.scene, alone.free) - without


def within_the_line(scene: Scene, alone: FreeForm) -> bool:
    """Whether the map is a damper or a spring within the contract's line: straight in the velocity or in
    the position, and of no more than 2 % of the command, or of twice that where the model's own number
    takes the rest back. Where the model's own damping acts elsewhere so little of it is no number of the
    model's, and no physics that it lacks. (Two masses with 4 % less damping at the motor: 47 nats, and 64
    held out; with 15 % more of it, 2.2 % that drives at the load beside 45 % more of the model's own: 58,
    and 26.)"""
    part = alone.parts[0]
    if len(alone.parts) > 1 or part.term.name not in STRAIGHT or alone.free.model.base.is_process:
        return False
    along, pushed, sent = [], [], []
    for trial in scene.trials:
        found = alone.free.follow(trial)
        if found is None:
            return False
        run, motions = found
        motion = motions[part.place]
        along.append(motion.v if part.term.name == "velocity" else motion.x)
        pushed.append(part.signal(motion))
        sent.append(run.u)
    x, force = np.concatenate(along), np.concatenate(pushed)
    columns = np.column_stack([x, np.ones_like(x)])
    line = np.linalg.lstsq(columns, force, rcond=None)[0]
    bent, size = (float(np.std(q)) for q in (force - columns @ line, force))
    share = size / max(float(np.std(np.concatenate(sent))), 1e-300)
    if not (bent < BENT * size and share < 2.0 * LINE):
        return False
    own = sizes(scene, alone.free.model).get(STRAIGHT[part.term.name], 0.0)
    return share < LINE or abs(own - math.copysign(share, line[0])) < LINE


def elsewhere(standing: Model, alone: FreeForm | None, gains: tuple[float, float]) -> str:
    """Where one map, at another port than the one effect that stands, explains as much as it, in words;
    "" where none does. (Where a spring holds a slow stage a sensor's bent scale is a gain by position:
    8 ahead where they were fitted, 0.3 behind held out; the gain was named with 0.97.)"""
    if alone is None or len(alone.parts) != 1 or len(standing.names) != 1:
        return ""
    name = standing.names[0]
    if name in standing.proven or min(gains) < -EVEN:
        return ""
    parts = (p for p in (*alone.parts, *alone.alike) if p.place.port != EFFECTS[name].port)
    return next((f"{p.place.words}: {phrase(p.term.variables)}" for p in parts), "")


def as_good(gains: tuple[float, float]) -> bool:
    """Maps and names explain the same."""
    return sum(gains) > 0.0 and min(gains) > -MARGIN


def nearly(scene: Scene, held: Scene | None, bare: Model, standing: Model, alone: FreeForm) -> bool:
    """The names take off nearly all that the maps do: something is wrong with them, but not much. What
    `bare`, the linear model with corrections of its own, takes off is neither's."""
    sets = [(scene.like(alone.scene), alone.white, np.ones(len(alone.white), bool))]
    if held is not None and held.trials:
        judged = held.like(alone.scene)
        sets.append((judged, alone.held_white, alone.known))
    for ground, white, known in sets:
        none, named = ground.residuals(bare), ground.residuals(standing)
        if none is None or named is None:
            return False
        if not known.any():
            continue
        whole, some, least = (
            float(np.mean(x[known] ** 2))
            for x in (ground.judge(none, known), ground.judge(named, known), white)
        )
        if whole - some < NEARLY * (whole - least) or some > FAR * least:
            return False
    return True


def cost_of(scene: Scene, standing: Model, alone: FreeForm) -> float:
    """Sum of squares that the names leave in the fitted recordings, under the maps' noise."""
    quiet = scene.like(alone.scene)
    left = quiet.residuals(standing)
    return np.inf if left is None else float(np.sum(quiet.whiten(left) ** 2))
