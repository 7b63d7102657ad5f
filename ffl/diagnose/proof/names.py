"""Which of the effects that stand are said by name."""

from __future__ import annotations

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.contest.line import slight
from ffl.diagnose.contest.unneeded import sureness
from ffl.diagnose.proof.verdict import BENT
from ffl.effects.periods import AGAIN
from ffl.systems.plant import Plant

PARTS_OF_THE_MASS = frozenset(
    {"mass_change", "flexible_mode"}
)  # each moves with the model's own mass


def named(standing: Judged, plant: Plant, whole: bool) -> tuple[list[int], list[str]]:
    """(places of the effects that are said, names of those that are not for want of a size); `whole`: what
    stands explains all there is. Else something else is missing too, and an effect that is less
    sure than large, in all of its amounts, stands in for it, and so does a sine of which no recording
    holds enough to see it repeat, and a change of mass that no machine's model is off by. (A weight picked
    up half way was a sine of 0.18 Hz in 6 s; a fan beside friction was 38 % less mass.)"""
    effects = standing.model.effects
    said = [i for i, spec in enumerate(effects) if not slight(spec, plant)]
    if whole:
        return said, []
    stands_in = (_sizeless, _passes_once, _of_no_such_mass)
    sized = [i for i in said if not any(test(standing, i) for test in stands_in)]
    return sized, [effects[i].name for i in said if i not in sized]


def _sizeless(standing: Judged, index: int) -> bool:
    spec = standing.model.effects[index]
    if spec.name in PARTS_OF_THE_MASS:
        return False
    return sureness(standing, index) < 1.0


def _passes_once(standing: Judged, index: int) -> bool:
    spec = standing.model.effects[index]
    if spec.name != "periodic_disturbance":
        return False
    longest = max(len(trial) * trial.sample_time for trial in standing.scene.trials)
    return float(spec.parameters["frequency"]) * longest < AGAIN


def _of_no_such_mass(standing: Judged, index: int) -> bool:
    spec = standing.model.effects[index]
    proven = spec.name in standing.model.proven
    return (
        spec.name == "mass_change" and not proven and abs(float(spec.parameters["change"])) > BENT
    )
