"""A play between two masses, fitted to what the switching filter leaves from sample to sample.

The linear model's corrections, the numbers of its company, mass ratio or load and the damping of the
contact are fitted with the gap, by log p(y | r) of `switching` with all noise scaled to what is left.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffl.diagnose.contest.parallel import each
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.linear import BOUND
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.noise import Noise
from ffl.diagnose.predict.company import along, separable, without
from ffl.diagnose.predict.foretold import Foretold, refitted
from ffl.diagnose.predict.moving import gap_at, masses, moved, units, walked
from ffl.diagnose.predict.slipping import FORMS
from ffl.diagnose.predict.switching import Switching
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import EFFECTS
from ffl.effects.backlash import PARTS
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

GAPS = np.geomspace(1e-4, 0.03, 12)  # of the travel
NONE = 1e-9
RATIOS = (0.4, 1.0, 2.5)
CONTACT = 0.05  # damping ratio of the contact to begin with
SHARES, FREQUENCIES, STICKY = (0.25, 0.5, 0.75), (60.0, 130.0), 0.2  # of a load behind the gap
SEEN = 0.35  # of the sampling rate: a contact that rings faster shows in no sample
STARTS = 3  # forms of the grid that are looked at more closely
LEAST_SHARE = 0.03  # of the mass: as good as none behind the gap
LOG_STEP = 0.01  # of a logarithm, for derivatives
CONTACT_STEP = 0.02  # of the contact's
COMPANY_STEP = 0.01  # of an effect's size
GLANCE, LOOK = 5000, 10000  # samples of all recordings that the grid and the fit look at
# Times the force noise: what it is more than stated holds the state to what is seen, as long as the
# numbers are off, and makes one broad valley of many narrow ones.
LOOSENESS = (30.0, 10.0, 3.0, 1.0)
MASSES = (-0.15, -0.1, -0.075, -0.05, -0.025, 0.025, 0.05, 0.075, 0.1, 0.15)  # of the mass, and
WIDTHS = np.geomspace(0.1, 4.0, 26)  # times a gap that was found: others that are tried
GRIDS = 2  # levels at which a grid of gaps is looked at: a heavy load hides under the loosest
LAST = (0.02, 0.01, 0.005)  # the same and of the mass at the end
ALONG = (0.1, 0.05, 0.02, 0.01)  # the same, of the combination that the samples see least
VALLEY, SLIDES = (0.25, 0.05), 4  # of the logarithm of the mass ratio, and steps either way
BESIDE = frozenset(
    {"constant_load", "linear_stiffness"}
)  # of the linear part, and no number of its own
PROMISES = 30.0  # log-likelihood by which the best gap of the grid must beat none


@dataclass(frozen=True)
class Hypothesis(Foretold):
    """A model with one backlash between two masses as its last effect, its contact's damping free, and
    the noise."""

    @classmethod
    def of(cls, model: Model, gap: float, options: Mapping[str, Any], noise: Noise) -> Hypothesis:
        spec, ratio = (
            EffectSpec("backlash", {"gap": float(gap)}, options),
            options.get("mass_ratio"),
        )
        others = [
            replace(s, options={**s.options, "mass_ratio": ratio})
            if "mass_ratio" in s.options
            else s
            for s in model.effects
        ]
        return cls(replace(model, effects=(*others, spec)), noise)

    @property
    def steps(self) -> Array:
        """Differences for derivatives: larger than what the moment of a contact jumps by."""
        steps = np.array([self._step(c) for c in self.model.coordinates])
        at = gap_at(self.model)
        steps[at] = 0.01 * max(self.theta[at], 1e-5 * self.model.base.travel)
        return steps

    def _step(self, c: Coordinate) -> float:
        if c.log:
            return CONTACT_STEP if c.effect >= 0 else LOG_STEP
        return (COMPANY_STEP if c.kind == "effect" else 0.2) * c.scale

    def predict(self, trials: Sequence[Trial]) -> tuple[Array, Array] | None:
        """(scaled innovations, logarithms of their scales) of all recordings; None: no such plant."""
        with np.errstate(all="ignore"):  # numbers that no machine has
            try:
                switching = Switching.of(self.model)
            except InputError:
                return None
            if switching is None:
                return None
            pairs = each(lambda trial: switching.predict(self._seen(trial), self.noise), trials)
            e, s = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
            white = e / s
            return (white, np.log(s)) if np.all(np.isfinite(white)) else None

    def _seen(self, trial: Trial) -> Trial:
        """The trial between the effects of the drive and of the scale."""
        others = self.model.effects[:-1]
        return without(trial, others) if others else trial


def able(spec: EffectSpec) -> bool:
    """Whether the filter can take the effect beside the play; a mass is the model's own number until it
    crosses the line, and so is a damping but where it acts on one side of the play alone."""
    return along(spec) or spec.name in (*BESIDE, *FORMS) or separable(spec)


def start(
    scene: Scene, model: Model, levels: Sequence[float] = LOOSENESS, most: int = GRIDS
) -> tuple[Hypothesis | None, Sequence[float]]:
    """The best gap, and mass ratio or load, of a grid, with the levels from the one that showed it: of a
    load behind a gap the first of `most`, between two masses the first or the last, whichever is best
    under the noise as it is. None where the plant is neither rigid nor two masses on a spring, or no gap
    of the grid foretells better than none."""
    trials = shortened(scene, GLANCE)
    coupled = len(model.base.simulator.mechanics.modes) == 2
    begun: list[tuple[float, Hypothesis, int]] = []
    for k in sorted({0, len(levels) - 1}) if coupled else range(most):
        if (best := of_grid(scene, model, levels[k])) is None:
            continue
        if not coupled:
            return best, levels[k:]
        begun.append((replace(best, noise=scene.noise).worth(trials), best, k))
    if not begun:
        return None, levels
    _, best, k = max(begun, key=lambda way: way[0])
    return best, levels[k:]


def of_grid(
    scene: Scene, model: Model, loose: float, sides: Collection[str] = PARTS
) -> Hypothesis | None:
    """The best gap and form of the grid under the scene's noise, its force so many times, where a rigid
    plant's own damping acts on one of `sides`; None where none foretells better than no play."""
    trials = shortened(scene, GLANCE)
    forms, travel = _forms(model), model.base.travel
    coupled = len(model.base.simulator.mechanics.modes) == 2
    noise = loosened(scene.noise, loose)
    found = []
    for form in forms[1:]:
        if form.get("damped", PARTS[0]) in sides:
            tried = [Hypothesis.of(model, g * travel, form, noise) for g in GAPS]
            found.append(max(((h.worth(trials), h) for h in tried), key=lambda pair: pair[0]))
    found.sort(key=lambda pair: -pair[0])
    if not found:
        return None
    none = Hypothesis.of(model, NONE * travel, forms[0], noise).scaled(trials)[0]
    if found[0][0] <= none + PROMISES:
        return None
    near = [moved(h, trials) for _, h in found[: 1 if coupled else STARTS]]
    return max(near, key=lambda h: h.worth(trials))


def closed(found: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
    """The same without a gap, all else fitted again: in contact throughout, or as the plant file has it."""
    model = replace(found.model, effects=found.model.effects[:-1])
    none, tried = NONE * model.base.travel, []
    for form in (found.model.effects[-1].options, _forms(model)[0]):
        bare = Hypothesis.of(model, none, form, found.noise)
        tried.append(refitted(bare, trials, fixed=(gap_at(bare.model),)))
    return max(tried, key=lambda h: h.worth(trials))


def _forms(model: Model) -> list[dict[str, Any]]:
    """Options of the backlash: first those of no play, as the plant file has the plant, then the
    forms that are tried. A rigid plant has a part of its mass behind the gap."""
    modes = model.base.simulator.mechanics.modes
    tried: list[dict[str, Any]]
    if len(modes) == 2:
        ratios = RATIOS if modes[1].sign < 0 else (None,)
        own = modes[1].damping / (2.0 * np.sqrt(modes[1].stiffness))
        tried = [{"kind": "coupling", "damping": CONTACT, "mass_ratio": r} for r in ratios]
        forms = [{**tried[0], "damping": own}, *tried]
        return [{k: v for k, v in form.items() if v is not None} for form in forms]
    if len(modes) != 1 or model.base.is_process or modes[0].stiffness > BOUND**2:
        return []
    shared = {"kind": "load", "damping": STICKY}
    most = SEEN / model.base.simulator.mechanics.sample_time
    frequencies = sorted({min(frequency, most) for frequency in FREQUENCIES})
    tried = [
        {**shared, "measured": "motor", "load_fraction": share, "frequency": frequency}
        for share in SHARES for frequency in frequencies
    ]  # fmt: skip
    tried += [
        {**form, "measured": "load"} for form in tried if form["frequency"] == frequencies[-1]
    ]
    none = {**tried[0], "load_fraction": LEAST_SHARE}
    if modes[0].damping > 0.0:  # which may be the load's
        tried += [{**form, "damped": "load"} for form in tried]
    return [none, *tried]


def loosened(noise: Noise, factor: float) -> Noise:
    return replace(noise, force=factor * noise.force, force_coloured=factor * noise.force_coloured)


def shortened(scene: Scene, samples: int) -> list[Trial]:
    each = samples // len(scene.trials)
    return [trial.head(min(each, len(trial))) for trial in scene.trials]


def settled(begun: Hypothesis, scene: Scene, levels: Sequence[float] = LOOSENESS) -> Hypothesis:
    """Numbers fitted under less and less force noise beyond the scene's, the best of them and of what it
    was begun with, under its own noise. (A hysteresis that was there: 275,613 under ten times the force
    noise, and refined under the noise as stated 270,231.)"""
    trials = shortened(scene, LOOK)
    best, most, last = begun, begun.worth(scene.trials), begun
    for loose in levels:
        noise = loosened(scene.noise, loose)
        last = moved(refitted(replace(last, noise=noise), trials), trials)
        value = last.worth(scene.trials)
        if value > most:
            best, most = last, value
    best = _along_valley(refitted(best, scene.trials), scene.trials)
    best = moved(refitted(best, scene.trials), scene.trials, LAST, mass=True)
    best = _moved_along(refitted(best, scene.trials), scene.trials)
    return refitted(best, scene.trials)


def regridded(found: Hypothesis, scene: Scene) -> Hypothesis:
    """`found`, or from another width of its gap, all else as it stands, where that foretells better: the
    likelihood has a hill wherever contacts fall on other samples. (1.81 mm beside a sine and friction
    that were right: 0.80, the truth, is 820 ahead.)"""
    best = _of_width(found, scene.trials)
    return found if best is found else settled(best, scene, (1.0,))


def _of_width(found: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
    """`found`, or with the width of its gap, all else as it stands, that foretells best."""
    at = gap_at(found.model)
    others = [_with(found, at, factor * found.theta[at]) for factor in WIDTHS]
    return max((found, *others), key=lambda h: h.worth(trials))


def of_another_mass(found: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
    """`found`, or with another mass of the model's, all else as it stands, where that foretells better: a
    change of some per cent moves every contact, and no derivative leads there. (Beside a friction 7.6 %
    less mass is 2,000 ahead of none, and 1 % less is behind.)"""
    others = [_with(found, k, mass) for k in masses(found.model) for mass in MASSES]
    return max((found, *others), key=lambda h: h.worth(trials))


def _with(found: Hypothesis, k: int, value: float) -> Hypothesis:
    """`found` with another value of its number k, all else as it stands."""
    theta = found.theta
    theta[k] = value
    return found.at(theta)


def _along_valley(point: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
    """Between two masses the one seen tells gap/(1 + mass ratio) to 0.2 %, each of both faintly: the ratio
    moved, the gap with it. (From 2.5, where refining ended: 72 of log-likelihood at 2.0, the truth.)"""
    coordinates = point.model.coordinates
    names, at, loads = [c.name for c in coordinates], gap_at(point.model), _on_load(point.model)
    if "mass_ratio" not in names:
        return point

    def slid(by: float) -> Hypothesis:
        ratio = float(point.model.effects[-1].options["mass_ratio"])
        theta = point.theta
        theta[names.index("mass_ratio")] += by
        times = (1.0 + ratio * np.exp(by)) / (1.0 + ratio)
        theta[at] *= times
        theta[loads] *= np.exp(by) / times  # as the load is heavier or lighter
        return point.at(theta)

    worth = point.worth(trials)
    for size in VALLEY:
        near = [slid(k * size) for k in range(-SLIDES, SLIDES + 1) if k]
        best = max(near, key=lambda h: h.worth(trials))
        if (value := best.worth(trials)) > worth:
            point, worth = best, value
    return point


def _on_load(model: Model) -> list[int]:
    """Which coordinates are forces on the load."""
    return [
        k
        for k, c in enumerate(model.coordinates)
        if c.effect >= 0 and not c.log and model.effects[c.effect].options.get("side") == "load"
        and "F" in EFFECTS[model.effects[c.effect].name].parameter(c.name).unit
    ]  # fmt: skip


def _moved_along(point: Hypothesis, trials: Sequence[Trial]) -> Hypothesis:
    """The combination of the effects' numbers that the samples see least, moved as long as it helps:
    gap and mass ratio go up together and what is seen is the same, gap/(1 + ratio); one by one no
    step along that valley helps."""
    worth = point.worth(trials)
    own = [k for k, c in enumerate(point.model.coordinates) if c.kind != "correction"]
    doubts = np.array([c.doubt for c in point.model.coordinates])
    for size in ALONG:
        found = point.predict(trials)
        if found is None:
            return point
        columns, unit = point.columns(trials, found[0]), units(point)
        table = (np.vstack([columns, np.diag(1.0 / doubts)]) * unit)[:, own]
        way = np.zeros(len(unit))
        way[own] = size * unit[own] * np.linalg.svd(table, full_matrices=False)[2][-1]
        point, worth = walked(point, worth, way, trials)
    return point
