"""Machines: the simulated closed loop with effects, one compiled kernel."""

from ffl.machines.simulated import SimulatedMachine
from ffl.machines.simulator import Simulation, Simulator, simulate

__all__ = ["SimulatedMachine", "Simulation", "Simulator", "simulate"]
