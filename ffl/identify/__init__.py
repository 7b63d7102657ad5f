"""Identification: inverse systems from data, with what is known of their uncertainty."""

from ffl.identify.bayes import Algorithm1Inverse, DirectBayesianInverse
from ffl.identify.closed_loop import InstrumentalInverse, ParametricInverse
from ffl.identify.evidence import Evidence, maximise_evidence, regularised
from ffl.identify.fir import KernelInverse, LeastSquaresInverse
from ffl.identify.inverse import Band, IdentifiedInverse, InverseBasis
from ffl.identify.kernels import KERNELS, Kernel
from ffl.identify.linear import LinearModel, best_linear, fit_linear
from ffl.identify.noise import NoiseModel, fit_noise, noise_of
from ffl.identify.rational import RationalInverse
from ffl.identify.regression import Edges, Regression, backward_regression, least_squares
from ffl.identify.two_stage import TwoStageInverse

__all__ = [
    "KERNELS",
    "Algorithm1Inverse",
    "Band",
    "DirectBayesianInverse",
    "Edges",
    "Evidence",
    "IdentifiedInverse",
    "InstrumentalInverse",
    "InverseBasis",
    "Kernel",
    "KernelInverse",
    "LeastSquaresInverse",
    "LinearModel",
    "NoiseModel",
    "ParametricInverse",
    "RationalInverse",
    "Regression",
    "TwoStageInverse",
    "backward_regression",
    "best_linear",
    "fit_linear",
    "fit_noise",
    "least_squares",
    "maximise_evidence",
    "noise_of",
    "regularised",
]
