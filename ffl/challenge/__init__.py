"""The blind challenge: an independent machine that conceals effects, and the scorer.

Nothing here simulates with `ffl.machines`, `ffl.effects` or `ffl.systems`: other equations, other
integrator, own discretisation, plant files written as plain text.
"""

from ffl.challenge.case import make_case
from ffl.challenge.make import NullCase, make, null_case, null_recordings
from ffl.challenge.score import score
from ffl.challenge.scorecard import Bar, bars, markdown
from ffl.challenge.solve import CaseFiles, find_cases, shipped_diagnosis, solve
from ffl.challenge.tally import Score, Share, as_json, tally

__all__ = [
    "Bar",
    "CaseFiles",
    "NullCase",
    "Score",
    "Share",
    "as_json",
    "bars",
    "find_cases",
    "make",
    "make_case",
    "markdown",
    "null_case",
    "null_recordings",
    "score",
    "shipped_diagnosis",
    "solve",
    "tally",
]
