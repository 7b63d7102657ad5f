"""What is said in the end: the contest's verdict, and rule after rule that takes something back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from ffl.diagnose.contest.judging import Judged
from ffl.diagnose.hypothesis.corrections import times_as_much
from ffl.diagnose.maps.outcome import Contest
from ffl.diagnose.proof.names import named
from ffl.diagnose.proof.prove import Proof
from ffl.diagnose.proof.unvisited import unvisited
from ffl.diagnose.proof.verdict import (
    BEYOND,
    LOUD,
    LOUDER,
    foretold,
    is_unlike,
    louder_than_noise,
    loudness,
    refuted,
    verdict,
)
from ffl.diagnose.recorded.trials import Trial
from ffl.diagnose.recorded.where import Place
from ffl.systems.plant import Plant

# Times the held-out nrmse before: names that leave more are not said. Where no noise is stated, all that
# is left passes for noise, and names that leave no less have shown nothing.
WORSE = 1.2
RIGHTED = 0.5  # of the held-out error: what a right unit leaves at most
IMPLAUSIBLE = 5.0  # times a mass or a gain: no machine is so far from its model, but a unit may be
# Of the nrmse before: where no noise is stated, nobody knows that more than this is noise.
MOST = 0.5
PARTED = 3.0  # times the nrmse of the model alone
NEARER = 0.9  # of the error of the command: what brings it there has shown itself


@dataclass(frozen=True)
class Ended:
    """All that a verdict rests on: `plant` as its file states it, what stands, the contest with the
    nameless, and the proof; `rounded`: what is left is the arithmetic's."""

    plant: Plant
    standing: Judged
    contest: Contest
    proof: Proof
    rounded: bool
    fitted: Sequence[Trial]
    held_out: Sequence[Trial]

    @property
    def trusted(self) -> bool:
        """Free runs say how good it is: it was not told by prediction, nor along measured motion."""
        return not self.standing.predicted and not self.contest.led

    @property
    def short_of_noise(self) -> bool:
        """The plant file states no noise at all, and free runs are all there is to judge by."""
        return self.trusted and not self.plant.machine.states_noise

    @property
    def far(self) -> bool:
        """Free runs of the held-out recordings leave far more than noise."""
        return self.trusted and beyond_noise(self.proof)

    @cached_property
    def loud(self) -> float:
        """What is left over the most that the stated noise can be; 0 where none is stated."""
        return loudness(self.plant, self.standing)

    @cached_property
    def unlike(self) -> bool:
        """The machine recorded is another one than the model's; noise may be most of what is left."""
        proof = self.proof
        another = self.trusted and is_unlike(proof.nrmse_after, proof.nrmse_with_map)
        return another and not 0.0 < self.loud <= LOUD

    @property
    def mistaken(self) -> bool:
        """A mass or gain is further off than a machine's can be, and puts most of the mismatch right: a
        unit. (A mass that runs off and leaves it stands for nothing.)"""
        proof = self.proof
        leaves = self.trusted and proof.nrmse_after > RIGHTED * proof.nrmse_before
        return self.runs_off and not leaves

    @cached_property
    def times(self) -> float:
        """Times as much force per command as the model has."""
        return times_as_much(self.standing)

    @property
    def runs_off(self) -> bool:
        return not 1.0 / IMPLAUSIBLE < self.times < IMPLAUSIBLE


@dataclass(frozen=True)
class Said:
    """Verdict and place; the effects told by name, those that stand without a size, and notes."""

    verdict: str
    place: Place
    told: tuple[int, ...] = ()
    sizeless: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def nothing_claimed(self) -> bool:
        return self.verdict == "inconclusive"

    def partly(self, note: str) -> Said:
        """The same, not the whole of it for the reason in `note`."""
        return replace(self, verdict="partly_explained", notes=(*self.notes, note))

    def noted(self, *notes: str) -> Said:
        return replace(self, notes=(*self.notes, *notes))


def verdict_of(ended: Ended) -> Said:
    """The contest's verdict after every rule, in the order of `RULES`."""
    out = _first(ended)
    for rule in RULES:
        out = rule(ended, out)
    return out


def _first(ended: Ended) -> Said:
    """By the contest, and which of its effects have names to be told by."""
    standing, proof = ended.standing, ended.proof
    floor = proof.noise_floor if ended.trusted else 0.0
    excess = proof.nrmse_after / floor if floor > 0 else 1.0
    word, place = verdict(ended.plant, standing, ended.contest, excess)
    if ended.rounded and word == "partly_explained":
        word = "explained"
    told, sizeless = named(standing, ended.plant, word != "partly_explained")
    none = not told and not sizeless
    if standing.model.effects and none and ended.contest.verdict == "named":
        word, place = "nothing_missing", Place("", "", ())
    if sizeless and not told:
        word = "unnamed"
    return Said(word, place, tuple(told), tuple(sizeless))


def _what_is_left(ended: Ended, said: Said) -> Said:
    if said.verdict != "partly_explained":
        return said
    if said.told and ended.loud > LOUDER:
        said = said.noted(
            f"what is left is {ended.loud:.2g} times as loud as the plant file's noise can make it"
        )
    elif (
        said.told
        and ended.contest.verdict == "named"
        and (more := louder_than_noise(ended.standing))
    ):
        said = said.noted(more)
    names, unit = ended.standing.model.names, ended.plant.output_unit
    beyond = unvisited(names, ended.fitted, ended.held_out, unit)
    return said.noted(beyond) if beyond else said


def _by_prediction(ended: Ended, said: Said) -> Said:
    if not ended.standing.predicted:
        return said
    word, notes = foretold(said.verdict, ended.proof, ended.standing.model.names)
    return replace(said.noted(*notes), verdict=word)


def _no_worse(ended: Ended, said: Said) -> Said:
    """Names that do not hold on held-out recordings are not said, but for what was seen directly. (A limit
    in noise, which opens the loop: 117 likelier, its free runs 1.3 times as far off as without it, and 1.05
    times as far as noise as loud as stated parts two of them.)"""
    model, proof = ended.standing.model, ended.proof
    noisy = WORSE if ended.plant.machine.states_noise else 1.0
    within = WORSE * proof.noise_floor if 0.0 < ended.loud <= LOUDER else 0.0
    worse = ended.trusted and not proof.nrmse_after < max(noisy * proof.nrmse_before, within)
    worse = worse or parted(ended.standing, proof) or (not ended.contest.led and idle(proof))
    if not (model.effects and worse) or said.verdict == "unnamed":
        return said
    if {spec.name for spec in model.effects} <= model.proven:
        return replace(said, verdict="partly_explained")
    word, place = refuted(ended.contest)
    return replace(said, verdict=word, place=place, notes=())  # all were of the names


def _better(ended: Ended, said: Said) -> Said:
    shown = ended.proof.improves or not ended.trusted or not ended.standing.model.effects
    if said.verdict != "explained" or shown:
        return said
    return said.partly("free runs of the held-out recordings are no better for what was named")


def _noise_is_stated(ended: Ended, said: Said) -> Said:
    if said.verdict != "explained" or not ended.short_of_noise:
        return said
    if ended.proof.nrmse_after > MOST * ended.proof.nrmse_before:
        return said.partly(
            "no noise is stated, and nobody knows that as much as is left is noise: state sensor_noise "
            "and force_noise in [machine]"
        )
    loud = loudness(ended.plant, ended.standing, True)
    if loud <= LOUDER:
        return said
    return said.partly(
        f"what is left is {loud:.2g} times as loud as the stated sensor_noise can make it; no "
        "force_noise is stated, and nobody knows that the rest is noise: state it in [machine]"
    )


def _this_machine(ended: Ended, said: Said) -> Said:
    if not ended.unlike:
        return said
    place = Place("plant", "the model as a whole: it is unlike the machine recorded", ())
    return replace(said, verdict="inconclusive", place=place)


def _some_machine(ended: Ended, said: Said) -> Said:
    if said.verdict == "unnamed" or not ended.runs_off:
        return said
    place = Place("", "what was fitted is no machine, and explains nothing", ())
    if ended.mistaken:
        what = f"the plant's gain or a unit: {ended.times:.4g} times as much per u"
        place = Place("plant", what, ())
    return replace(said, verdict="inconclusive", place=place)


RULES: tuple[Callable[[Ended, Said], Said], ...] = (
    _what_is_left,
    _by_prediction,
    _no_worse,
    _better,
    _noise_is_stated,
    _this_machine,
    _some_machine,
)


def parted(standing: Judged, proof: Proof) -> bool:
    """Free runs of what was told by prediction are far off: those of a play may be, of a friction they are
    not. (A limit and a friction left 27 times what nothing did of a stage that friction held.)"""
    told = standing.predicted and "backlash" not in standing.model.names
    return told and proof.nrmse_after > PARTED * proof.nrmse_before


def beyond_noise(proof: Proof) -> bool:
    """Held-out runs are far from what noise alone leaves."""
    return proof.nrmse_after > BEYOND * proof.noise_floor > 0.0


def idle(proof: Proof) -> bool:
    """Held-out runs are far from what noise alone leaves, and surely nearer neither in y nor in u: what was
    named is no share of the mismatch. (Liquid that sloshed: a mode of 40 % and a sine, 5.2 times
    the noise with them as without; a belt that slipped: 15 % less mass and a play, 7.5 times.)"""
    before, after = proof.u_nrmse_before, proof.u_nrmse_after
    sent = before is not None and after is not None and after < NEARER * before
    return beyond_noise(proof) and proof.interval[1] >= 0.0 and not sent
