"""What a hypothesis without a name is: its maps, what they leave, and what that is worth held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.diagnose.contest.judging import effective
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.maps.freemodel import FreeModel, Part
from ffl.systems.state_space import Array


@dataclass(frozen=True)
class Ranked:
    """A map by name, where it would enter, and the log-evidence it has."""

    name: str
    port: str
    evidence: float


@dataclass(frozen=True)
class FreeForm:
    """A hypothesis without a name: its maps, and what it leaves.

    `evidence`: gained by the maps in the fitted recordings; `white`, `held_white`: whitened residuals
    under `scene`'s noise; `known`: held-out samples at which the maps can be judged, since the machine
    is, and has been for a while, where it was in the fitted recordings. `ranking`: all maps at all
    ports as they were screened, best first. `scene` and `held` begin as the maps have it, where a
    recording begins in motion. `untold`: the held-out recordings hardly show the maps. `alike`: other
    maps that do as much in the place of the last one.
    """

    free: FreeModel
    scene: Scene
    evidence: float
    white: Array
    held_white: Array
    known: Array
    ranking: tuple[Ranked, ...] = ()
    held: Scene | None = None
    untold: bool = False
    alike: tuple[Part, ...] = ()

    @property
    def parts(self) -> tuple[Part, ...]:
        return self.free.parts

    @property
    def name(self) -> str:
        return " + ".join(p.term.name for p in self.parts) or "nothing"

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(v for p in self.parts for v in p.term.variables))

    @property
    def cost(self) -> float:
        return float(self.white @ self.white)

    @property
    def held_cost(self) -> float:
        """Mean square of the held-out residual where it can be judged; 0 where there is none."""
        return float(np.mean(self.held_white[self.known] ** 2)) if self.known.any() else 0.0

    @property
    def port(self) -> str:
        return self.parts[0].place.port if self.parts else ""


def held_gain(before: Array, after: Array, known: Array) -> float:
    """Log-likelihood that held-out residuals gain, n/2 log(mean square before/after), the scale free;
    n: independent samples of the better one. Only samples that are `known` count."""
    if not known.any():
        return 0.0
    a, b = before[known], after[known]
    first, second = float(np.mean(a**2)), float(np.mean(b**2))
    if first == second:
        return 0.0
    return 0.5 * effective(b if second < first else a) * float(np.log(first / second))
