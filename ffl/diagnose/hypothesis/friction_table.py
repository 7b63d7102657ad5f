"""A friction table made as fine as the recordings carry, and no finer than they need.

A table over position and direction is general enough to take over what simpler terms say: where speed
goes with position, as it does on a machine that repeats its moves, the table and viscous friction
trade against each other without a trace in the fit. So the simple terms come first: dry friction by
direction and damping are what they are without the table, and the table is what they leave.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.judging import PER_NUMBER, Judged, charged, judge, levelled
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.effects import EFFECTS
from ffl.effects.position_dependent_friction import CUBIC, drawn_out, is_cubic

NAME = "position_dependent_friction"
MOST_KNOTS = 33
SHARE = (
    0.004  # of the number of samples: log-likelihood that another form of the contact must bring
)
GIVES = np.geomspace(1e-6, 1e-2, 9)  # of the stroke: travel before the contact slides
RATIOS = (0.6, 1.5)  # of the level at standstill to that in motion
SPEEDS = (0.03, 0.1, 0.3)  # of the largest speed: where friction reaches its level in motion
OBJECTION = (
    0.002  # of the number of samples: score that tells the table's damping from the simple one
)
SIMPLE = "damping"  # the correction that a table can take over


def refined(quiet: Scene, held: Scene | None, judged: Judged, say: Callable[[str], None]) -> Judged:
    """`judged` with a contact that yields, a level that changes near standstill, a curve between the knots
    of its table and twice as many of them, each as long as that pays, and with the simple terms first."""

    def tried(model: Model) -> Judged:
        return judge(quiet, held, model, 6, judged.fit)

    if NAME not in judged.model.names:
        if SIMPLE not in judged.model.held or not judged.model.corrections.get(SIMPLE):
            return judged  # nor has a table ever held it: as stated it is held for another reason
        return tried(replace(judged.model, held=judged.model.held - {SIMPLE}))
    top = max(float(np.abs(judged.model.simulate(trial).v).max()) for trial in quiet.trials)
    current, form = judged, judged
    for label, forms in (("yielding", _yielding), ("easing", _easing)):
        rungs = list(forms(form.model, top))
        if not rungs:
            continue
        form = tried(rungs[int(np.argmin([quiet.cost(rung) for rung in rungs]))])
        say(f"  {label} contact: {_gain(form, current)}")
        if _pays(form, current):  # the second may pay where the first alone does not
            current = form
        elif _loses(form, current):
            break
    if not _is_smooth(current.model):
        smooth, current = levelled([tried(_smooth(current.model)), current])
        say(f"  a smooth table: {_gain(smooth, current)}")
        current = smooth if smooth.score > current.score else current
    last = np.inf
    while (finer := _finer(current.model)) is not None:
        if last < PER_NUMBER * (len(finer.theta) - len(current.model.theta)):
            break  # the next doubling brings less than this one did
        other = tried(finer)
        say(f"  {len(_table(finer)['grid'])} knots: {_gain(other, current)}")
        last = other.fitted - current.fitted
        if not _pays(other, current, 0.0):
            break
        current = other
    return _simple_first(current, tried, say)


def no_patch(
    quiet: Scene,
    held: Scene | None,
    base: Judged,
    rivals: Sequence[Judged],
    say: Callable[[str], None],
) -> list[Judged]:
    """Those of `rivals`, who add an effect to `base`, that are no patch of a table too coarse for what
    it holds: what goes by position must bring the fitted recordings more than twice the knots do, all
    numbers charged. (A cogging brought 51 beside a table that twice the knots would bring 113.)"""
    suspects = [r for r in rivals if "position" in EFFECTS[r.model.names[-1]].depends_on]
    finer = _finer(base.model) if suspects and NAME in base.model.names else None
    if finer is None:
        return list(rivals)
    bar = charged(judge(quiet, held, finer, 6, base.fit), base)
    out = [r for r in rivals if r not in suspects or charged(r, base) > bar]
    if len(out) < len(rivals):
        say(f"  the table itself with twice the knots: {bar:+.1f} fitted, its numbers charged")
    return out


def _gain(other: Judged, current: Judged) -> str:
    a, b = levelled([other, current])
    return f"{a.fitted - b.fitted:+.1f} fitted, {a.held_out - b.held_out:+.1f} held out"


def _pays(other: Judged, current: Judged, share: float = SHARE) -> bool:
    """In the fitted and the held-out recordings alike, by a share of the samples of each."""
    other, current = levelled([other, current])
    fitted = charged(other, current)
    held = other.held_out - current.held_out
    n = len(current.held_white)
    return fitted > share * len(current.fit.white) and (held > share * n or not n)


def _loses(other: Judged, current: Judged) -> bool:
    """Clearly worse in the fitted recordings: nothing built on it will pay."""
    return current.fitted - other.fitted > SHARE * len(current.fit.white)


def _simple_first(
    current: Judged, tried: Callable[[Model], Judged], say: Callable[[str], None]
) -> Judged:
    """`current` with the damping that a plain dry friction finds, unless the recordings object."""
    if SIMPLE in current.model.held or SIMPLE not in {c.name for c in current.model.coordinates}:
        return current
    values, table = _values(current.model), _table(current.model)
    plain: dict[str, Any] = {"grid": [table["grid"][0], table["grid"][-1]]}
    plain |= {key: [float(np.mean(table[key]))] * 2 for key in ("positive", "negative")}
    values = {k: v for k, v in values.items() if k in ("table", "stiffness")}
    base = tried(_with(current.model, {**values, "table": plain}))
    fixed = {**current.model.corrections, SIMPLE: base.model.corrections.get(SIMPLE, 0.0)}
    held = current.model.held | {SIMPLE}
    other = tried(replace(current.model, corrections=fixed, held=held))
    say(f"  {SIMPLE} as plain dry friction has it: {_gain(other, current)}")
    # In the fitted recordings alone: damping that is held is not granted its doubt where another judges.
    lost = replace(current, held_out=0.0).score - replace(other, held_out=0.0).score
    return current if lost > OBJECTION * len(current.fit.white) else other


def _yielding(model: Model, top: float) -> Iterator[Model]:
    """Contacts of several stiffnesses where there is none."""
    values, table = _values(model), _table(model)
    if "stiffness" in values:
        return
    stroke = table["grid"][-1] - table["grid"][0]
    for give in GIVES * stroke:
        yield _with(model, {**values, "stiffness": values["level"] / give})


def _easing(model: Model, top: float) -> Iterator[Model]:
    """Levels that rise or fall with speed near standstill, where the contact yields."""
    values = _values(model)
    if "static_ratio" in values or "stiffness" not in values:
        return
    for share in SPEEDS:
        for ratio in RATIOS:
            yield _with(model, {**values, "static_ratio": ratio, "stribeck_velocity": share * top})


def _is_smooth(model: Model) -> bool:
    return is_cubic(model.effects[model.names.index(NAME)].options)


def _smooth(model: Model) -> Model:
    """With a cubic spline through the knots."""
    effects = tuple(
        replace(e, options={**e.options, **CUBIC}) if e.name == NAME else e for e in model.effects
    )
    return replace(model, effects=effects)


def _finer(model: Model) -> Model | None:
    """Twice the knots."""
    table = _table(model)
    grid = np.linspace(table["grid"][0], table["grid"][-1], 2 * len(table["grid"]) - 1)
    if len(grid) > MOST_KNOTS:
        return None
    whole = drawn_out(table) if _is_smooth(model) else table
    sides = {k: np.interp(grid, whole["grid"], whole[k]).tolist() for k in ("positive", "negative")}
    return _with(model, {**_values(model), "table": {"grid": grid.tolist(), **sides}})


def _values(model: Model) -> dict[str, Any]:
    return dict(model.effects[model.names.index(NAME)].parameters)


def _table(model: Model) -> dict[str, list[float]]:
    return dict(_values(model)["table"])


def _with(model: Model, values: dict[str, Any]) -> Model:
    """The model with other numbers in its table's effect; `level` follows the table."""
    index = model.names.index(NAME)
    table = values["table"]
    values = {**values, "level": float(np.mean([table["positive"], table["negative"]]))}
    return model.with_parameters(index, values)
