"""What the contest of names with the nameless came to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffl.diagnose.maps.dropouts import Dropouts
from ffl.diagnose.maps.form import FreeForm
from ffl.diagnose.maps.formula import Formula
from ffl.diagnose.maps.freemodel import Part
from ffl.diagnose.recorded.events import Events
from ffl.diagnose.recorded.repeating import Repeating


@dataclass(frozen=True)
class Contest:
    """`alone`: maps in place of names (its `parts` empty where there are none); `beside`: maps on top
    of the names; `fitted`, `held_out`: what `alone` gains over the names; `events`: bursts in what
    maps in place of names leave, else in what the names leave. `verdict`: 'named', 'unnamed', 'partly'
    or 'nothing'."""

    verdict: str
    alone: FreeForm | None
    beside: FreeForm | None
    fitted: float
    held_out: float
    events: Events | None
    variables: tuple[str, ...] = ()
    needed: tuple[tuple[str, float], ...] = ()  # share of the evidence that each variable is worth
    formulas: tuple[Formula, ...] = ()
    lost: Dropouts | None = None  # commands that did not arrive: what is unnamed, in place of maps
    repeats: Repeating | None = None  # a disturbance that every recording has at the same time
    led: bool = False  # the map was seen along the motion as measured: free runs do not follow it
    instead: bool = False  # `beside` stands in the place of the names, which do nearly as much
    elsewhere: str = ""  # where else one map explains as much as the one effect that is named

    @property
    def mapped(self) -> tuple[str, ...]:
        """Of the variables those of the maps."""
        own = () if self.winner is None else self.winner.variables
        return tuple(v for v in self.variables if v in own)

    @property
    def bursts_remain(self) -> bool:
        """What maps in place of names leave comes in bursts."""
        return self.verdict == "unnamed" and self.events is not None and self.events.found

    @property
    def winner(self) -> FreeForm | None:
        return self.alone if self.verdict == "unnamed" else self.beside


def component_of(parts: Sequence[Part]) -> str:
    """The component of the machine that a map's port points to."""
    part = parts[0]
    if part.place.port == "force":
        return "environment" if "heat" in part.term.along else "plant"
    return {"command": "actuator", "output": "sensor"}[part.place.port]
