"""One recording of another machine, or of the same one in another state, among those of one machine.

What stands in the contest is one set of numbers for all recordings. Where one of them is of a sister
machine, whatever bridges the two wins it (heat, by which friction of 4 N becomes 11), or it holds on what
was fitted and fails on what judges. An engineer makes one regression per file. So each recording in turn
is left out: with the same structure fitted to the others and to it, mean squares in units of the noise
are

    a   of the others,    b   of the one with the others' numbers,    c   of the one with its own.

It is of another machine where a and c are noise, b is far more, and the numbers are surely and clearly
others. (A sister of 9.6 kg and 11 N among recordings of 7 kg and 4 N: 1.04, 9,516 and 1.01; of a guide
that warms up, beside dry friction, none has a or c below 48.) Physics that the model leaves out shows
elsewhere in its range too, so nothing is said where that one was elsewhere, or moved otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.ground import Ground
from ffl.diagnose.hypothesis.amounts import own_damping
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.fit import Fit, fit
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import of_the_machine
from ffl.diagnose.recorded.against_controller import Fault
from ffl.diagnose.recorded.trials import stretches
from ffl.effects import EFFECTS
from ffl.recordings import Recording
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

LOUD = 4.0  # times the stated noise, in the mean square: more must be left of some recording
NOISE = 2.25  # times what the others leave, or each of them by itself: at most, in the mean square
APART = 16.0  # times it: what the others' numbers leave of the odd one, at least
LONGEST = 20_000  # samples looked at
MOST = 12  # numbers: a table fits any one recording
SURE = 10.0  # standard errors of both by which numbers must differ
SHARE = 0.2  # of an effect's number: what it must differ by
CHANGES = 5.0  # that matter, of a correction: the same
LIKE = 1.5  # times as fast, or as hard: no more, and no less, than the others moved
WITHIN = 0.5  # of its travel that must lie within theirs
FIRST = 5  # rounds, after which recordings of one machine lie near the noise (those two: after two)
NEAR = 100.0  # times the stated noise, in the mean square: near it
BEGUN = 0.05  # of the RMS command: the dry friction that a fit begins with
WINDOWS = 200  # of a recording, over which its motion is read


@dataclass(frozen=True)
class _Alone:
    """One source left out: the fit of the others, and its own."""

    source: str
    others: Fit
    own: Fit
    told: tuple[int, ...]  # coordinates whose numbers differ


def of_another_machine(
    ground: Ground, standing: Judged, say: Callable[[str], None] = lambda line: None
) -> Fault | None:
    """The one recording that what stands, or the linear model beside dry friction, explains to the noise
    with other numbers than the others; None where there is none, or more than one."""
    if ground.seen.folded or ground.told.effects or standing.predicted:
        return None
    scene = replace(ground.scene, noise=ground.prior)
    pieces: dict[str, list[Recording]] = {}
    for r in stretches([*ground.recordings, *ground.validation], LONGEST):
        pieces.setdefault(r.source, []).append(r)
    scenes = {s: replace(scene, trials=ground.trials(own)) for s, own in pieces.items()}
    stated = ground.seen.model.machine.states_noise
    if len(scenes) < (2 if stated else 3):
        return None
    if max(own.cost(standing.model) / own.samples for own in scenes.values()) < LOUD:
        return None
    say("checking whether one recording asks for other numbers than the others")
    for model in _structures(ground, standing.model):
        found = [_left_out(model, scenes, source, stated) for source in scenes]
        odd = [one for one in found if one and _moved_alike(pieces, one.source)]
        if len(odd) == 1 or (odd and len(scenes) == 2):
            return _said(odd[-1], list(scenes), {r.source for r in ground.recordings})
    return None


def _structures(ground: Ground, stands: Model) -> list[Model]:
    """What stands, its numbers free, unless it goes by time, each recording its own, or is a table; the
    linear model beside dry friction, at each place."""
    free = replace(stands, held=ground.told.held, unmoved=ground.told.unmoved)
    timed = any(EFFECTS[name].scan == "time" for name in stands.names)
    out = [] if timed or len(free.coordinates) > MOST else [free]
    simulator = ground.told.base.simulator
    if simulator.mechanics.modes and not ground.told.base.is_process:
        command = np.concatenate([trial.u for trial in ground.scene.trials])
        level = BEGUN * float(np.sqrt(np.mean(command**2))) * abs(simulator.force_per_input)
        rubs = EffectSpec("coulomb_friction", {"level": level})
        places = of_the_machine(ground.told)
        out += [ground.told.with_effect(replace(rubs, options=p.options)) for p in places]
    return out


def _left_out(
    model: Model, scenes: Mapping[str, Scene], source: str, stated: bool
) -> _Alone | None:
    """`source` against the others, where it is the odd one among recordings that agree."""
    own, rest = scenes[source], [scene for s, scene in scenes.items() if s != source]
    trials = tuple(trial for scene in rest for trial in scene.trials)
    both = replace(own, trials=trials)
    others = fit(both, model, rounds=FIRST)
    if stated and _square(others) > NEAR:
        return None
    others = fit(both, others.model, known=others.known())
    level = _square(others)
    if stated and level > LOUD:
        return None
    if not own.cost(others.model) > APART * level * own.samples:
        return None
    alone = fit(own, others.model)
    if not _square(alone) <= NOISE * level:
        return None
    if len(rest) > 1 and any(level > NOISE * _square(fit(s, others.model)) for s in rest):
        return None
    told = tuple(k for k, c in enumerate(others.model.coordinates) if _differs(c, k, others, alone))
    return _Alone(source, others, alone, told) if told else None


def _square(found: Fit) -> float:
    return found.cost / max(len(found.white), 1)


def _differs(c: Coordinate, k: int, others: Fit, own: Fit) -> bool:
    """Whether a number is surely another, and clearly."""
    if c.kind == "option" or c.place is not None:
        return False
    here, there = others.model.theta[k], own.model.theta[k]
    apart, error = abs(there - here), float(np.hypot(others.spread[k], own.spread[k]))
    size = SHARE if c.log else SHARE * max(abs(here), abs(there))
    size = CHANGES * c.scale if c.kind == "correction" else size
    return bool(apart > SURE * error and apart > size)


def _moved_alike(pieces: Mapping[str, Sequence[Recording]], source: str) -> bool:
    """Whether `source` went where the others went, as fast and as hard."""
    low, high, *sizes = _motion(pieces[source])
    rest = [_motion(own) for s, own in pieces.items() if s != source]
    within = min(high, max(m[1] for m in rest)) - max(low, min(m[0] for m in rest))
    if within < WITHIN * (high - low):
        return False
    ranges = zip(sizes, zip(*(m[2:] for m in rest), strict=True), strict=True)
    return all(min(them) / LIKE <= size <= max(them) * LIKE for size, them in ranges)


def _motion(recordings: Sequence[Recording]) -> tuple[float, float, float, float]:
    """Least and largest y, RMS speed and RMS acceleration."""
    steps: list[tuple[Array, Array]] = []
    window = max(1, max(map(len, recordings)) // WINDOWS)
    for r in recordings:
        v = (r.y[window:] - r.y[:-window]) / (window * r.sample_time)
        steps.append((v, (v[window:] - v[:-window]) / (window * r.sample_time)))
    v, a = (np.concatenate(parts) for parts in zip(*steps, strict=True))
    low, high = min(r.y.min() for r in recordings), max(r.y.max() for r in recordings)
    return float(low), float(high), float(np.sqrt(np.mean(v**2))), float(np.sqrt(np.mean(a**2)))


def _said(odd: _Alone, sources: Sequence[str], fitted: set[str]) -> Fault:
    labels = [_label(odd.own.model, odd.own.model.coordinates[k]) for k in odd.told]
    own, others = ([_number(f.model, k) for k in odd.told] for f in (odd.own, odd.others))
    asks = _listed([f"{name} {value}" for name, value in zip(labels, own, strict=True)])
    than = _listed(others)
    if len(sources) == 2:
        other = next(s for s in sources if s != odd.source)
        return Fault(
            odd.source, "machine", f"the machine, or its state, against {other}",
            f"these two are not of one machine: {odd.source} by itself asks for {asks}, where {other} "
            f"asks for {than}, and each is then explained to the noise: another machine, another load, or "
            "something changed in between; find out which it was, and diagnose recordings of one",
        )  # fmt: skip
    mend = (
        "leave it out"
        if odd.source in fitted
        else "judge by a recording of the one that was fitted"
    )
    return Fault(
        odd.source, "machine", "the machine, or its state, in this recording",
        f"{odd.source} by itself asks for {asks}, where the others ask for {than}, and each is then "
        "explained to the noise: another machine, another load, or something changed in between; find out "
        f"which it was, and {mend}",
    )  # fmt: skip


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]


def _label(model: Model, c: Coordinate) -> str:
    if c.kind == "correction":
        return c.name
    name = (model.stated if c.kind == "given" else model.effects)[c.effect].name
    return f"{name} {c.name}"


def _number(model: Model, k: int) -> str:
    """Number `k` for a reader: a correction as a share of what the plant file has."""
    c = model.coordinates[k]
    if c.kind != "correction":
        spec = (model.stated if c.kind == "given" else model.effects)[c.effect]
        unit = EFFECTS[spec.name].parameter(c.name).unit_in(model.base.plant)
        return f"{float(spec.parameters[c.name]):.3g} {unit}"
    value = float(model.corrections.get(c.name, 0.0))
    if c.name == "damping":
        own = own_damping(model)
        if abs(value) > own:
            return f"{value:+.2g} 1/s"
        value /= own
    return f"{round(100.0 * value, 1) + 0.0:+.1f} %"  # no minus zero
