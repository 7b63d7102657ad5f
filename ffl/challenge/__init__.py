"""The blind challenge: an independent machine that conceals effects, and the scorer.

Nothing here simulates with `ffl.machines`, `ffl.effects` or `ffl.systems`: other equations, other
integrator, own discretisation, plant files written as plain text.
"""

from ffl.challenge.case import make_case
from ffl.challenge.make import NullCase, make, null_recordings

__all__ = ["NullCase", "make", "make_case", "null_recordings"]
