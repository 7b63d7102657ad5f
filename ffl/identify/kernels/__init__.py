"""Kernels: prior covariances of a two-sided impulse response. One file each; the dict names them."""

from ffl.identify.kernels.algebra import Fixed, Product, Sum
from ffl.identify.kernels.base import Decaying, Factor, Kernel
from ffl.identify.kernels.dc import DC
from ffl.identify.kernels.diagonal import Diagonal
from ffl.identify.kernels.direct import Direct
from ffl.identify.kernels.obf import OBF
from ffl.identify.kernels.stable_spline import StableSpline
from ffl.identify.kernels.tc import TC

KERNELS: dict[str, type[Kernel]] = {
    "tc": TC,
    "dc": DC,
    "stable_spline": StableSpline,
    "diagonal": Diagonal,
    "obf": OBF,
    "direct": Direct,
}

__all__ = [
    "DC",
    "KERNELS",
    "OBF",
    "TC",
    "Decaying",
    "Diagonal",
    "Direct",
    "Factor",
    "Fixed",
    "Kernel",
    "Product",
    "StableSpline",
    "Sum",
]
