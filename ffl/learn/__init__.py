"""Learning from trial to trial: the loop, the updates, their certificates."""

from ffl.learn.along_trajectory import AlongTrajectory
from ffl.learn.constraints import Constraints
from ffl.learn.free_signal import FreeSignalUpdate
from ffl.learn.norm_optimal import NormOptimal, Update, UpdateReport
from ffl.learn.trial_loop import LearningTask, Machine, Trial, learn, trial_rng
from ffl.learn.weights import Weights

__all__ = [
    "AlongTrajectory",
    "Constraints",
    "FreeSignalUpdate",
    "LearningTask",
    "Machine",
    "NormOptimal",
    "Trial",
    "Update",
    "UpdateReport",
    "Weights",
    "learn",
    "trial_rng",
]
