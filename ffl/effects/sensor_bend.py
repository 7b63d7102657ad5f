"""A sensor whose scale bends: from a level on it gives another amount per unit."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import MEAN
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array

SHARES = np.linspace(0.06, 0.94, 23)  # of the range of levels


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: level, ratio."""
    if io[MEAN] > p[0]:
        io[MEAN] = p[0] + p[1] * (io[MEAN] - p[0])


class SensorBend(Effect):
    """y = x below `level`, level + ratio (x - level) above: a scale calibrated in two pieces, a float in
    a vessel that narrows.

    Looked for on rows of lags, where the gain is a correction at any size and the scale is thus that
    below the bend; on other plants a curve of the sensor is a map (`ffl.diagnose.maps`).
    """

    name = "sensor_bend"
    component = "sensor"
    port = "output"
    sides = ("sensor",)
    parameters = (
        Parameter("level", "x", lower=-np.inf, linear=False),
        Parameter("ratio", "", lower=0.05, upper=20.0, neutral=1.0),
    )
    depends_on = ("position",)
    siblings = ("outflow", "spill", "sensor_nonlinearity", "position_dependent_gain")
    of_processes = True
    valleys = (
        "level"  # beside tanks that are not yet what they are, a bend at the wrong place helps too
    )
    law = staticmethod(_law)

    def shown(self, values: Parameters, position: Any) -> Any:
        beyond = np.maximum(position - values["level"], 0.0)
        return position + (values["ratio"] - 1.0) * beyond

    def passes(self, values: Parameters, seen: Array) -> Array:
        return np.where(seen > values["level"], values["ratio"], 1.0)

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        low = float(motion.x.min())
        return [{"level": low + float(share) * motion.span} for share in SHARES]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        return np.maximum(motion.x - nonlinear["level"], 0.0)[:, None]

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        ratio = self.parameter("ratio")
        more = float(np.clip(1.0 + coefficients[0], ratio.lower, ratio.upper))
        return {**nonlinear, "ratio": more}

    def coefficients_of(self, values: Parameters) -> Array:
        return np.array([values["ratio"] - 1.0])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Above {self.quantity(values, 'level', plant)} the sensor gives {values['ratio']:.3g} times "
            "as much per unit."
        )
