"""What noise tells of the modes: the force's noise rings them, whatever a recording asks for.

A mode that moves and scans hardly excite is open to them, and a multisine that judges shows how far off it
is. But noise runs through the machine all the time, and its colour has the mode's frequency and damping in
it. Around each mode they are sought by Whittle's likelihood of what the model leaves,
    -sum(log(density) + periodogram/density),
beside what the recordings say of them without noise (the fit's covariance) and what is believed of them.
So are the mass and the damping of a stage on a spring, which slow moves show as little.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize

from ffl.diagnose.contest.dry import DRY
from ffl.diagnose.contest.earning import LEAST
from ffl.diagnose.contest.judging import Judged, judge, raw_error, raw_residuals
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.fit import fit, surprise
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.colour import loop_of, mistaken
from ffl.diagnose.noise.noise import Paths
from ffl.systems.state_space import Array

AROUND = 0.15  # of a mode's frequency: as far as its colour is looked at on either side
WINDOW = 1.5  # Hann's: bins of a periodogram that are worth one
STEPS = np.linspace(
    -3.0, 3.0, 25
)  # of what is believed of a frequency, from which the search begins
OPEN = 1e12  # squares of what is believed: data that leave as much open see nothing
TRIES = 120  # evaluations of the density that it may take
MASSES = np.geomspace(0.4, 2.5, 15)  # of that on a spring as it stands, from which it is sought
AROUND_FIRST = 0.4  # of the frequency of that
CLEARLY = 25.0  # log-likelihood of the noise by which it must be another
RUBS = frozenset({"backlash", *DRY})  # which noise does not pass as a linear machine does


@dataclass(frozen=True)
class Band:
    """The periodogram of what is left, `power` (M,), at the `frequencies` (M,) around a mode, Hz."""

    frequencies: Array
    power: Array

    @classmethod
    def around(
        cls, frequency: float, residuals: Sequence[Array], step: float, share: float = AROUND
    ) -> Band:
        at, power = [], []
        for e in residuals:
            window = np.hanning(len(e))
            spectrum = np.abs(np.fft.rfft(window * (e - e.mean()))) ** 2 / np.sum(window**2)
            f = np.fft.rfftfreq(len(e), step)
            near = np.abs(f - frequency) < share * frequency
            at.append(f[near])
            power.append(spectrum[near])
        return cls(np.concatenate(at), np.concatenate(power))

    def log_likelihood(self, scene: Scene, model: Model, louder: float) -> float:
        """Of the noise of `scene`, `louder` by e^louder here, in the loop of `model`."""
        paths = Paths.of(loop_of(model), self.frequencies)
        density = scene.noise.density(paths) * np.exp(2.0 * louder)
        return -float(np.sum(np.log(density) + self.power / density)) / WINDOW


def with_modes_heard(held: Scene | None, judged: Judged) -> Judged:
    """`judged` with the modes as the noise has them, the other numbers fitted beside; as it was where they
    are no likelier, or free runs of the recordings that judge speak against them."""
    scene, model = judged.scene, judged.model
    plain = scene.plain or scene.observed or judged.predicted or mistaken(model)
    if plain or judged.fit.far or any(t.unrest is not None for t in scene.trials):
        return judged
    residuals = raw_residuals(scene, model)
    moved = dict(model.corrections)
    for k, mode in enumerate(model.simulator.mechanics.modes[1:], 1):
        names = [n for n in (f"mode_{k}_frequency", f"mode_{k}_damping") if _free(model, n)]
        frequency = float(np.sqrt(abs(mode.stiffness))) / (2.0 * np.pi)
        band = Band.around(frequency, residuals, scene.loop.system.sample_time)
        if names and len(band.power) > 2 * len(names):
            moved |= _heard(judged, replace(model, corrections=moved), names, band)
    if moved == dict(model.corrections):
        return judged
    return _fitted_beside(held, judged, moved)


def on_its_spring(
    quiet: Scene, held: Scene | None, current: Judged, say: Callable[[str], None]
) -> Judged | None:
    """`current`, a mass on a spring that nothing rubs, with mass and damping as the noise has them, held
    there; None where these are no others, or recordings that judge speak against them. (Slow moves see
    neither: half of a mass gone beside a limit was 12 of log-likelihood, and 1,864 of the noise, which rang
    41 % higher; without it the noise was twice as loud as the machine's.)"""
    model, scene = current.model, current.scene
    names = [n for n in ("mass", "damping") if _free(model, n)]
    plant, bound = model.base.plant, _free(model, "stiffness") and not model.base.is_process
    if plant.controller is not None or not plant.machine.states_noise or not (bound and names):
        return None
    plain = scene.plain or scene.observed or current.predicted or current.fit.far
    if plain or RUBS & set(model.names):
        return None
    residuals, moved, best = raw_residuals(scene, model), dict(model.corrections), model
    if names[0] == "mass":
        best = max(_masses(model), key=lambda m: _in_own_noise(scene, m, residuals))
    loud = replace(scene, loop=loop_of(best)).with_noise_of(residuals)
    mode = best.simulator.mechanics.modes[0]
    frequency = float(np.sqrt(abs(mode.stiffness))) / (2.0 * np.pi)
    calm = [e for e, t in zip(residuals, scene.trials, strict=True) if t.unrest is None]
    band = Band.around(frequency, calm or residuals, scene.loop.system.sample_time, AROUND_FIRST)
    if len(band.power) > 2 * len(names):
        found = _heard(replace(current, scene=loud), best, names, band)
        moved |= found or {n: float(best.corrections.get(n, 0.0)) for n in names}
    other = replace(model, corrections=moved)
    gained = _in_own_noise(scene, other, residuals) - _in_own_noise(scene, model, residuals)
    if held is not None:
        left = raw_residuals(held := held.like(scene), model)
        gained += min(_in_own_noise(held, other, left) - _in_own_noise(held, model, left), 0.0)
    told = ", ".join(f"{n} {moved.get(n, 0.0):+.3g}" for n in names)
    say(f"  {told} as the noise rings: {gained:+.1f}")
    if gained < CLEARLY:
        return None
    other = replace(other, held=model.held | frozenset(names))
    return judge(replace(scene, loop=loop_of(other)), held, other, 10)


def _masses(model: Model) -> list[Model]:
    now = 1.0 + model.corrections.get("mass", 0.0)
    others = [{**model.corrections, "mass": float(times * now - 1.0)} for times in (1.0, *MASSES)]
    return [replace(model, corrections=corrections) for corrections in others]


def _in_own_noise(scene: Scene, model: Model, residuals: Sequence[Array]) -> float:
    """Log-likelihood of what is left, were it all noise in the loop of `model`; and of its numbers."""
    return replace(scene, loop=loop_of(model)).in_own_noise(residuals) - surprise(model)


def _free(model: Model, name: str) -> bool:
    return any(c.kind == "correction" and c.name == name for c in model.coordinates)


def _heard(judged: Judged, model: Model, names: Sequence[str], band: Band) -> Mapping[str, float]:
    """The numbers of one mode that are likeliest; none where they are hardly likelier than they stood."""
    where = [
        k
        for name in names
        for k, c in enumerate(model.coordinates)
        if c.kind == "correction" and c.name == name
    ]
    coordinates = [model.coordinates[k] for k in where]
    scale = np.array([c.doubt for c in coordinates])
    begin = model.theta[where]
    covariance = judged.fit.covariance[np.ix_(where, where)] / np.outer(scale, scale)
    unseen = ~(np.diag(covariance) < OPEN)
    covariance[unseen] = covariance[:, unseen] = 0.0
    covariance[unseen, unseen] = OPEN
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors / np.sqrt(np.maximum(values, 1e-18))).T
    believed = surprise(model)

    def at(z: Array) -> Model:
        theta = model.theta.copy()
        theta[where] = begin + z * scale
        return model.at(theta)

    def unlikely(p: Array) -> float:
        other = at(p[:-1])
        known = 0.5 * float(np.sum((root @ p[:-1]) ** 2)) + surprise(other) - believed
        return known - band.log_likelihood(judged.scene, other, p[-1])

    zero = np.zeros(len(names) + 1)
    steps = STEPS if names[0].endswith("frequency") else ()
    starts = [zero + np.eye(len(zero))[0] * step for step in (0.0, *steps)]
    start = min(starts, key=unlikely)
    simplex = np.vstack([start, start + np.diag(np.append(np.full(len(names), 0.1), 0.3))])
    found = scipy.optimize.minimize(
        unlikely, start, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": TRIES}
    )
    level = scipy.optimize.minimize_scalar(
        lambda louder: unlikely(np.append(zero[:-1], louder)), bounds=(-2.0, 2.0), method="bounded"
    )
    if found.fun > level.fun - LEAST:
        return {}
    best = at(found.x[:-1])
    return {name: best.corrections[name] for name in names}


def _fitted_beside(held: Scene | None, judged: Judged, moved: Mapping[str, float]) -> Judged:
    model = judged.model
    changed = frozenset(n for n, value in moved.items() if value != model.corrections.get(n))
    other = replace(model, corrections=dict(moved), held=model.held | changed)
    scene = replace(judged.scene, loop=loop_of(other))
    again = judge(scene, held, other, 6)
    # What the fitted recordings leave open is granted where others judge (`doubt`): by their free runs. The
    # likelihood of the whole goes up and down with its noise, fitted by bands wider than a mode.
    alone = held is None and not again.fitted > judged.fitted
    worse = alone or raw_error(held, again.model) > raw_error(held, judged.model)
    if again.fit.status == "diverged" or worse:
        return judged
    free = fit(again.scene, replace(again.model, held=model.held), rounds=0)
    return replace(again, fit=free)
