"""Forward linear models from recordings, open and closed loop, with their uncertainty."""

from ffl.identify.linear.delay import estimate_delay
from ffl.identify.linear.fit import best_linear, fit_linear
from ffl.identify.linear.noise import ResidualTest
from ffl.identify.linear.result import LinearModel, Overlay, Rung
from ffl.identify.linear.roots import RootEstimate
from ffl.identify.linear.signals import Signals, as_signals

__all__ = [
    "LinearModel",
    "Overlay",
    "ResidualTest",
    "RootEstimate",
    "Rung",
    "Signals",
    "as_signals",
    "best_linear",
    "estimate_delay",
    "fit_linear",
]
