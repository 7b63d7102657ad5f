"""What it comes to: explained, partly explained, unnamed, nothing missing or inconclusive, and where."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ffl.diagnose.contest.judging import Judged, effective
from ffl.diagnose.contest.line import astray
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.outcome import Contest, component_of
from ffl.diagnose.noise.lost import mean_power
from ffl.diagnose.noise.noise import Noise, Paths
from ffl.diagnose.proof.prove import Proof
from ffl.diagnose.recorded import where
from ffl.diagnose.recorded.states import VARIABLES, State, goes_with, states
from ffl.effects import EFFECTS
from ffl.systems.plant import Plant

LOUD = 3.0  # times the stated noise: louder than an engineer can have been mistaken
# The same, from which what names leave is not all noise. (Dry friction and the drag of a fan went into 12 %
# more damping, and 1.8 times the noise that was stated passed for noise.)
LOUDER = 1.5
WHITE = 0.25  # of the samples independent: a residual with fewer is structure, not noise
BENT = 0.3  # of a mass, gain or stiffness: an engineer's is known to some per cent
# Mean square of the whitened held-out residual above which structure remains; below its reciprocal too:
# what the fitted recordings were left with is louder where they are louder, and so no noise.
STRUCTURED = 1.5
# Times what noise alone leaves of held-out free runs, from which they say that structure remains, however
# white it is: a sensor with a bent scale explained as a gain by position left 3.9 times that.
BEYOND = 2.5
RATTLES = (
    "the loop rattles across the play, and two runs of one machine part within a second: the play was "
    "named by prediction from sample to sample; free-running figures say little"
)
FOLLOWS = (
    "the play was named by prediction from sample to sample, and free runs of it leave {:.2g} times what "
    "noise parts two of them by: there is a play, and its gap or what acts beside it is not this machine's"
)
SMOOTHS = (
    "noise decides when this machine sticks and slips, which a free run knows nothing of: dry friction was "
    "named by prediction from sample to sample"
)
NO_NEARER = (
    "free runs with it are no nearer to what was recorded than those of the model alone, and no farther "
    "from it than noise parts two runs of such a machine: free-running figures say little"
)
FARTHER = (
    "free runs with it leave {:.2g} times what noise parts two of them by: there is friction, and its "
    "level or what acts beside it is not this machine's"
)
UNDECIDED = "the model would have"  # numbers that stand for what is missing, if anything is
DIGITS = 1e-9  # of y's range: what is left below that is rounding
# nrmse of the best model above which it is another machine, and a map's share of a larger one: free runs of
# a printer whose guide warms up are 195 % off, and 62 % with the map.
UNLIKE = 0.5
OF_A_STATE = 3.0  # times the mean power: bursts so loud in a state belong to it (knocks: 1.2)


def verdict(
    plant: Plant, standing: Judged, contest: Contest, excess: float = 1.0
) -> tuple[str, where.Place]:
    """The answer's verdict and place; `plant` as its file states it; `excess`: error of held-out free runs
    over what noise alone leaves of them."""
    if contest.verdict == "unnamed":
        return "unnamed", _nameless(contest)
    effects = standing.model.effects
    if effects:
        chi2 = mean_power(standing.held_white) if len(standing.held_white) else 1.0
        names = [EFFECTS[e.name] for e in effects]
        depends = dict.fromkeys(d for e in names for d in e.depends_on)
        said = where.phrase(names[0].depends_on, named=True)
        short = coloured(standing) or bent(standing) or loudness(plant, standing) > LOUDER
        short = short or not 1.0 / STRUCTURED < chi2 < STRUCTURED or excess > BEYOND
        if contest.verdict == "named" and short:
            return "partly_explained", _left(standing, names[0].component, said, depends)
        if contest.verdict == "named":
            return "explained", where.Place(names[0].component, said, tuple(depends))
        rest = _nameless(contest)
        depends |= dict.fromkeys(rest.depends_on)
        told = (
            "in its place, without a name, a little better" if contest.instead else "what is left"
        )
        return "partly_explained", where.Place(
            names[0].component, f"{said}; {told}: {rest.where}", tuple(depends),
            port=rest.port, formula=rest.formula, ports=rest.ports,
        )  # fmt: skip
    excess = loudness(plant, standing)
    if excess > LOUD:
        return "inconclusive", where.Place("", f"noise {excess:.2g} times as loud as stated", ())
    if numbers := astray(standing):
        off = [
            f"{n} {100.0 * s:.2g} %{'' if n == 'mass' else ' of the force'}"
            for n, s in numbers.items()
        ]
        said = f"{UNDECIDED} {' and '.join(off)} off: more than a number, and no effect that holds"
        return "inconclusive", where.Place("plant", said, ())
    return "nothing_missing", where.Place("", "", ())


def louder_than_noise(standing: Judged) -> str:
    """How much more than noise names leave of the recordings that judge, in words; "" where it is noise."""
    white = standing.held_white
    if not len(white) or (power := mean_power(white)) < STRUCTURED:
        return ""
    return f"what is left of the recordings that judge has {power:.2g} times the power of the noise"


def foretold(said: str, proof: Proof, names: Collection[str]) -> tuple[str, tuple[str, ...]]:
    """`said` of what was named by prediction, and notes: free runs say little where noise parts two of them
    as far as they are off. (A joint whose load rubs behind its play: "explained" with 5.7 mrad for 2.0:
    free runs of it 12 times as far off as noise parts two, and further than without a play. Of a stage on a
    spring with the true friction by position they leave 1.4 times what the model alone does, and so do two
    runs of that machine.)"""
    apart = proof.nrmse_after / max(proof.noise_floor, 1e-300)
    short = "partly_explained" if said == "explained" else said
    if "backlash" in names:
        return (said, (RATTLES,)) if apart <= BEYOND else (short, (FOLLOWS.format(apart),))
    if apart > BEYOND:
        return short, (SMOOTHS, FARTHER.format(apart))
    return said, (SMOOTHS,) if proof.improves else (SMOOTHS, NO_NEARER)


def is_unlike(error: float, with_map: float | None) -> bool:
    """Whether held-out runs with the nrmse `error`, and `with_map` beside a map that won, are those of
    another machine than the one recorded."""
    mapped = np.inf if with_map is None else with_map
    return error > UNLIKE and mapped > UNLIKE * max(1.0, error)


def refuted(contest: Contest) -> tuple[str, where.Place]:
    """Verdict and place where what was named does not hold on the held-out recordings: the map's beside it
    where one won. (A stop at the end of the travel wore a hardening spring's name.)"""
    if contest.winner is not None:
        return "unnamed", _nameless(contest)
    said = "what was fitted does not hold on the held-out recordings"
    return "inconclusive", where.Place("", said, ())


def in_their_state(place: where.Place, contest: Contest, found: Sequence[State]) -> where.Place:
    """Where bursts are all that is told: with the state in which they are by far the loudest, if there is
    one. (A wheel that slips does so at every hard start, at whatever time; knocks come in any state.)"""
    told = contest.winner or contest.lost or contest.repeats
    if contest.verdict != "unnamed" or told is not None:
        return place
    loudest = max(found, key=lambda s: s.power, default=None)
    if loudest is None or loudest.power < OF_A_STATE:
        return place
    variable = VARIABLES[loudest.name]
    return replace(
        place,
        component="plant",
        where=f"{place.where}: {loudest.power:.2g} times the mean power in {loudest.name}",
        depends_on=tuple(dict.fromkeys((variable, *place.depends_on))),
    )


def coloured(standing: Judged) -> bool:
    """Taken as white noise at the output for want of a better one, and far from white: whatever it is,
    it is no noise."""
    white = standing.fit.white
    return standing.scene.plain and effective(white) < WHITE * len(white)


def bent(standing: Judged) -> bool:
    """Mass, gain or stiffness further off than a model of this machine can be: bent to stand in for
    physics that has no name yet."""
    if standing.model.base.is_process:
        return False  # a gain and lags are corrections at any size
    numbers = standing.model.corrections
    return any(abs(numbers.get(name, 0.0)) > BENT for name in ("mass", "gain", "stiffness"))


def _left(standing: Judged, component: str, said: str, depends: dict[str, None]) -> where.Place:
    """The place of what was named, with the variables that go with what it leaves."""
    motions = [standing.model.follow(trial).motion() for trial in standing.scene.trials]
    left = goes_with(states(standing.fit.white, motions))
    return where.Place(
        component,
        f"{said}; what is left: {where.phrase(left)}" if left else said,
        tuple(depends | dict.fromkeys(left)),
    )


def _nameless(contest: Contest) -> where.Place:
    winner = contest.winner
    if contest.lost is not None:
        search = contest.lost.fitted
        said = f"{search.lost:.0f} of {search.scene.samples} samples, as far as they can be told"
        return where.Place(
            "timing",
            f"commands that did not arrive, the drive keeping the one before: at {said}",
            contest.variables, port="beside the command",
        )  # fmt: skip
    if contest.repeats is not None:
        return where.Place("environment", contest.repeats.words, contest.variables, port="a force")
    if winner is None:
        assert contest.events is not None
        return where.Place(
            "environment",
            f"bursts, {len(contest.events.stretches)} of them in one recording, that nothing tried "
            "explains",
            contest.variables,
        )
    place = winner.parts[0].place
    said = f"{place.words}: {where.phrase(contest.mapped)}"
    for part in winner.alike:
        said += f", or as well {part.place.words}: {where.phrase(part.term.variables)}"
    if contest.led:
        said += ", along the motion as measured, which free runs with it do not follow"
    if contest.bursts_remain:
        said += "; and bursts, at times of their own, that it does not explain"
    return where.Place(
        component_of(winner.parts), said,
        contest.variables, port=place.words,
        formula="; ".join(f.text for f in contest.formulas), ports=_ports(winner),
    )  # fmt: skip


def _ports(winner: FreeForm) -> tuple[tuple[str, float], ...]:
    """Every port with the log-evidence of the best map there, over none; not where no map has any."""
    best: dict[str, float] = {}
    for r in winner.ranking:
        if np.isfinite(r.evidence):
            best[r.port] = max(best.get(r.port, -np.inf), r.evidence)
    return tuple(sorted(best.items(), key=lambda item: -item[1]))


def loudness(plant: Plant, standing: Judged, sensor_alone: bool = False) -> float:
    """RMS of what is left over what the plant file's own noise would leave at most, were all of its
    force noise slow; 0 where the file states no such noise (`sensor_alone`: none of the sensor)."""
    m = plant.machine
    if not (m.sensor_noise if sensor_alone else m.states_noise):
        return 0.0
    loop = standing.scene.loop
    n = 2048
    frequencies = (np.arange(n) + 0.5) / n * 0.5 / plant.sample_time
    paths = Paths.of(loop, frequencies)
    sensor = float(np.hypot(m.sensor_noise, m.encoder_resolution / np.sqrt(12.0)))
    force = 0.0 if sensor_alone else m.force_noise
    stated = Noise(sensor, 0.0, sensor, 30.0, force, 5.0).density(paths)
    left = standing.scene.noise.density(paths)
    return float(np.sqrt(np.mean(left) / np.mean(stated)))


def rounding(standing: Judged) -> bool:
    """What is left of recordings without noise is that of the arithmetic, and of the digits in a file."""
    trials = standing.scene.trials
    left = standing.scene.residuals(standing.model)
    return left is not None and all(
        float(np.std(e)) < DIGITS * float(np.ptp(trial.y))
        for e, trial in zip(left, trials, strict=True)
    )
