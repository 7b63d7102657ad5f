"""Dry friction behind a spring that the model lacks: it slides with the load, not with the motor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ffl.diagnose.contest.dry import DRY, PLAINEST, level_of
from ffl.diagnose.contest.judging import Judged, best_against, judge, noise_error, raw_error
from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.contest.settle import KEEP
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import hangs
from ffl.effects.mechanics import HUNG
from ffl.systems.plant import EffectSpec

LOUD = 4.0  # times the squares of noise that are left: less, and nothing of the kind is missing
NEARBY = (0.7, 1.0, 1.4)  # times the frequency of a mode that stands
SHARES = (0.3, 0.6)  # of the mass, behind the spring
FREQUENCIES = 14  # tried where no mode stands
SLOWEST, FASTEST = 8.0, 0.1  # periods in the longest recording; of the sampling rate
ROUNDS, BEST = 6, 2  # of each, and how many of them are fitted to the end


def behind_its_mode(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """A mode with plain dry friction at its load in the place of a mode, of dry friction, or of both, where
    what these leave is louder than noise; None where that is no likelier. A machine of one body alone has
    it to be told: beside a spring that it lacks friction where it is measured seems to yield before it
    slides, and a mode without friction to be damped. (A conveyor whose load rubbed behind a belt of 31 Hz
    was told presliding friction, and left 17 times the noise; a belt of 60 Hz a damper of four times the
    machine's own.)"""
    model = current.model
    if not model.names or not set(model.names) <= DRY | {HUNG, "viscous_friction"}:
        return None
    modes = model.base.simulator.mechanics.modes
    if len(modes) != 1 or model.base.is_process or quiet.plain or quiet.observed or model.proven:
        return None
    heard = current.held or quiet  # under whose noise it was judged
    if raw_error(held, model) < LOUD * noise_error(held, heard):
        return None
    dry = next((e for e in model.effects if e.name in DRY), None)
    if dry is not None and hangs(model) and dry.options.get("side") == "load":
        return None
    level = (level_of(dry) if dry is not None else None) or _level(quiet, model)
    starts = [_start(model, level, mode) for mode in _modes(quiet, model)]
    tried = sorted(each(partial(_begun, quiet), starts), key=lambda one: one.cost)[:BEST]
    ended = [judge(quiet, held, one.model, 4 * ROUNDS, one) for one in tried]
    found = best_against(ended, current)
    if found is None:
        return None
    best, gained = found
    say(f"  {best.name}, at the load: {gained:+.1f}")
    return best if gained > KEEP else None


def _modes(quiet: Scene, model: Model) -> list[dict[str, float]]:
    """Numbers of a mode from which a fit is begun: near one that stands, else over all that can be seen."""
    own = next((e for e in model.effects if e.name == HUNG), None)
    if own is not None:
        at, share = (float(own.parameters[name]) for name in ("frequency", "mass_fraction"))
        frequencies, shares = [at * near for near in NEARBY], [share]
    else:
        step = model.base.plant.sample_time
        longest = step * max(len(trial) for trial in quiet.trials)
        frequencies = list(np.geomspace(SLOWEST / longest, FASTEST / step, FREQUENCIES))
        shares = list(SHARES)
    return [
        {"frequency": float(f), "damping": 0.03, "mass_fraction": s}
        for f in frequencies
        for s in shares
    ]


def _level(quiet: Scene, model: Model) -> float:
    """A tenth of the largest command, as a force: any level in its reach leads to the right one."""
    largest = max(float(np.abs(trial.u).max()) for trial in quiet.trials)
    return 0.1 * largest * model.simulator.force_per_input


def _start(model: Model, level: float, mode: dict[str, float]) -> Model:
    hung = replace(model, effects=()).with_effect(EffectSpec(HUNG, mode, {}))
    return hung.with_effect(EffectSpec(PLAINEST, {"level": level}, {"side": "load"}))


def _begun(quiet: Scene, start: Model) -> Fit:
    return fit(quiet, start, rounds=ROUNDS)
