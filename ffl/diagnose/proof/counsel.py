"""What to do next, in words: the experiment that was found, or what to record where none was."""

from __future__ import annotations

from ffl.diagnose.predict.observer import needs_observer
from ffl.diagnose.proof.advise import Experiment
from ffl.diagnose.proof.verdict import UNDECIDED
from ffl.diagnose.recorded.where import Place
from ffl.systems.plant import Plant


def advice_of(
    said: str, place: Place, experiment: Experiment | None, model: Plant
) -> tuple[str, ...]:
    """Lines for the verdict `said` about `place`; `model` as its file states it."""
    if said == "inconclusive" and "unlike" in place.where:
        return (other_model(model),)
    if said == "inconclusive" and "hold" in place.where:
        begin = "record one wave at half and at full size: what does not scale is the physics"
        if not model.is_identified:
            begin = "begin with ffl identify linear"
        return (f"fit and judge by recordings over the same range, or {begin}",)
    out = [] if experiment is None else [experiment.advice]
    if said == "inconclusive" and not place.where.startswith(UNDECIDED):
        out.append(
            "what is left is louder than the noise that the plant file states, and nothing of the "
            "catalogue explains it: record standstill for the noise, and slow moves with reversals"
        )
    if said == "unnamed" and experiment is None:
        out.append(_again(place))
        if model.controller is None and needs_observer(model):
            out.append(
                "only where a controller made u: put it into the plant file as [controller] and record r; "
                "free runs of the loop then tell more"
            )
    return tuple(out)


def _again(place: Place) -> str:
    """What to record of that for which no experiment was found."""
    twice = "record the same move twice"
    if place.component == "environment" and not place.port:
        return (
            f"{twice}, and as long at standstill: bursts at the same places of the move are the machine's, "
            "bursts at standstill come from outside"
        )
    if place.component == "environment" and place.depends_on == ("time",):
        return (
            "record standstill, from the same beginning: what is there then too comes from outside; then "
            "one move begun later than usual, which tells what starts it"
        )
    if place.component == "timing":
        return f"{twice}, with a counter of the commands that the drive received beside them"
    return f"{twice}: what comes back is the machine, what does not is not"


def other_model(model: Plant) -> str:
    """What to try where the model is unlike the machine; not once more what it came from."""
    if not model.is_identified:
        return "identify a linear model of this machine first: ffl identify linear"
    return (
        "the model was identified from a recording that its form does not fit, feedback or strong "
        'physics in it: state what is known instead (mass or inertia as form = "czpk", and the '
        "[controller]), or identify from small motion, or without the controller"
    )
