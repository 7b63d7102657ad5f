"""Machines: the simulated closed loop with effects, one compiled kernel."""

from ffl.machines.linearised import is_linear, linear_part
from ffl.machines.simulated import SimulatedMachine
from ffl.machines.simulator import Simulation, Simulator, simulate

__all__ = ["SimulatedMachine", "Simulation", "Simulator", "is_linear", "linear_part", "simulate"]
