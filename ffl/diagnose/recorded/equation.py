"""The equation of the stated controller: u = f + C_r r - C_y y, held to the drive's limit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffl.diagnose.recorded.commands import NEAR, at_limit, limit_of
from ffl.recordings import Recording
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array
from ffl.systems.zpk import as_state_space

SHIFTS = 64  # samples
MARGIN = 200  # the same, in which the controller forgets where it began
FEW = 0.1  # of the samples: with fewer below a limit it is none to compare by
ROWS = 20000


class Equation:
    """u - f = a C_r r - b C_y y + free response of the controller, over the first rows, those at the
    `limit` of the drive left out (None: as the plant file states it)."""

    def __init__(self, plant: Plant, recording: Recording, limit: float | None = None) -> None:
        assert plant.controller is not None
        limit = limit or limit_of(plant)
        n = min(len(recording), ROWS)
        self.u, self.f = recording.u[:n], recording.f[:n]
        self.y = recording.y[:n]
        reference = as_state_space(plant.controller.reference)
        self.output = as_state_space(plant.controller.output)
        self.by_r = np.atleast_1d(reference.filter(recording.r[:n]))
        self.by_y = np.atleast_1d(self.output.filter(self.y))
        self.free = plant.controller.state_space.free_response(n)
        self.size = float(np.sqrt(np.mean(self.u**2))) or 1.0
        self.kept = ~at_limit(self.u, limit)
        # What goes beyond the limit was recorded before it, or in another unit.
        cut = limit is not None and np.abs(self.u).max() <= (1.0 + NEAR) * limit
        self.limit = limit if cut and np.mean(self.kept) > FEW else None
        if self.limit is None:
            self.kept[:] = True

    @property
    def given(self) -> Array:
        """What the stated controller gives, but for where it began."""
        return self.f + self.by_r - self.by_y

    def stated(self) -> tuple[float, Array]:
        """(relative RMS of what the equation leaves of u as it stands, residual)."""
        _, _, rest = self.left(self.u - self.given)
        if self.limit is not None:
            sent = np.clip(self.u - rest, -self.limit, self.limit)
            rest = np.where(self.kept, rest, self.u - sent)
        return float(np.sqrt(np.mean(rest**2))) / self.size, rest

    def left(self, target: Array, columns: Sequence[Array] = ()) -> tuple[float, Array, Array]:
        """(relative RMS of what is left below the limit, coefficients of the columns, residual)."""
        table = np.column_stack([*columns, self.free]) if len(columns) else self.free
        if table.shape[1] == 0:
            return float(np.sqrt(np.mean(target[self.kept] ** 2))) / self.size, np.zeros(0), target
        own = table[self.kept]
        scale = np.maximum(np.linalg.norm(own, axis=0), 1e-300)
        solution = np.linalg.lstsq(own / scale, target[self.kept], rcond=1e-12)[0] / scale
        rest = target - table @ solution
        size = float(np.sqrt(np.mean(rest[self.kept] ** 2)))
        return size / self.size, solution[: len(columns)], rest


def stated_ratio(plant: Plant, recording: Recording) -> float:
    """RMS of u - f - C_r r + C_y y over that of u, with the stated controller."""
    return Equation(plant, recording).stated()[0]


def behind(eq: Equation, most: int) -> tuple[float, int]:
    """What is left of u where it is what the controller gives some samples later, fewer than `most`, and
    how many leave least."""
    return min((moved(eq, eq.u - np.roll(eq.given, k)), k) for k in range(1, most))


def moved(eq: Equation, part: Array) -> float:
    """RMS of what is left of u, in shares of it, away from the ends."""
    within = slice(SHIFTS + MARGIN, len(part) - SHIFTS)
    part = part[within][eq.kept[within]]
    part = part - np.mean(part) if eq.free.shape[1] else part
    return float(np.sqrt(np.mean(part**2))) / eq.size
