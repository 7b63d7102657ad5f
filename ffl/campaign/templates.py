"""Files to start from: `ffl init` and `ffl new`."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from ffl.errors import InputError
from ffl.systems.atomic import write_text
from ffl.systems.plant_file import suggest

PLANT = """# y = P u at `sample_time`; u = C (r - y) + f. SI units.
name = "{name}"
sample_time = 0.001 # s
source = "where the numbers come from"

[units]
input = "N"
output = "m"

[plant] # a mass of 10 kg under a zero-order hold: T^2/(2 m) (z + 1)/(z - 1)^2
form = "zpk"
zeros = [-1.0]
poles = [1.0, 1.0]
gain = 5.0e-8

[controller] # lead with roll-off, crossover near 27 Hz
form = "zpk"
zeros = [0.98]
poles = [0.75]
gain = 5.0e5

[physics]
mass = 10.0 # kg
motor_constant = 1.0 # the input is the force itself

[machine] # how the real thing differs from mathematics; used when it runs, not by the model
encoder_resolution = 1.0e-6
sensor_noise = 1.0e-7
force_noise = 0.01

# [[effects]] # physics beside the linear plant
# name = "coulomb_friction"
# parameters = {{ level = 2.0 }}
"""

CAMPAIGN = """# ffl check {name}.toml; ffl run {name}.toml
name = "{name}"
seed = 1
trials = 6
model = "{name}_model.toml"     # what the update believes
machine = "{name}_machine.toml" # what runs

[reference]
kind = "moves"
moves = [{{ start = 0.2, distance = 0.1, velocity = 0.3, acceleration = 3.0, jerk = 100.0 }}]
duration = 1.5

[[runs]]
name = "derivatives"
basis = [{{ kind = "derivatives", orders = ["velocity", "acceleration", "jerk", "snap"] }}]
weights = {{ error = 1.0, feedforward = 1e-14 }}

[[runs]]
name = "fir"
basis = [{{ kind = "fir", preview = 3, lag = 3 }}]
weights = {{ error = 1.0, feedforward = 1e-14 }}
"""

BASIS = '''"""One line that says which feedforward this is."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ffl.bases.base import Basis
from ffl.systems.state_space import Array


class {cls}(Basis):
    """f = theta_1 psi_1(r): the formula, with the units of the parameters and its source."""

    def __init__(self, sample_time: float = 1.0) -> None:
        self.sample_time = float(sample_time)

    @property
    def names(self) -> list[str]:
        return ["{name}"]

    def regressors(self, reference: ArrayLike) -> Array:
        """psi_k(r), shape (N, n_parameters)."""
        return np.asarray(reference, float)[:, None]
'''

EFFECT = '''"""One line that says which physics this is."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import V0, V1
from ffl.effects.solve import set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: coefficient. The force is a straight line over the sub-step; ffl/effects/law.py says how."""
    set_line(io, -p[0] * io[V0] ** 3, -p[0] * io[V1] ** 3)


class {cls}(Effect):
    """F = -coefficient v^3: the formula, with its source."""

    name = "{name}"
    parameters = (Parameter("coefficient", "F s^3/x^3"),)
    depends_on = ("velocity",)
    siblings = ("quadratic_drag", "viscous_friction")
    law = staticmethod(_law)

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-(motion.v**3)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return f"A force of {{self.quantity(values, 'coefficient', plant)}} opposes the motion."
'''

KINDS = {"effect": EFFECT, "basis": BASIS, "plant": PLANT}


def new_file(what: str, name: str, folder: Path) -> tuple[Path, str]:
    """Writes the file that a new effect, basis or plant starts from; (path, how to register it)."""
    if what not in KINDS:
        raise InputError(f"new '{what}': {suggest(what, list(KINDS))}")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise InputError(f"name '{name}': use lower case letters, digits and underscores")
    path = folder / f"{name}{'.toml' if what == 'plant' else '.py'}"
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name or folder")
    if what != "plant" and name in _registered(what):
        raise InputError(f"{what} '{name}': in the catalogue already; choose another name")
    cls = "".join(part.capitalize() for part in name.split("_"))
    write_text(path, KINDS[what].format(name=name, cls=cls))
    if what == "plant":
        return path, ""
    home, table = ("bases", "BASES") if what == "basis" else ("effects", "EFFECTS")
    entry = f'"{name}": {cls}' if what == "basis" else f"{cls}()"
    return path, (
        f"put it into ffl/{home}/; in ffl/{home}/__init__.py import {cls} from "
        f"ffl.{home}.{name} and add {entry} to {table}"
    )


def _registered(what: str) -> Collection[str]:
    from ffl.bases import BASES
    from ffl.effects import EFFECTS

    return BASES if what == "basis" else EFFECTS


def init_folder(folder: Path) -> list[Path]:
    """A folder with a campaign, its model and its machine, ready for `ffl run`."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: exists and is not empty; give a new folder")
    name = re.sub(r"[^a-z0-9_]+", "_", folder.resolve().name.lower()).strip("_") or "campaign"
    machine = PLANT.replace("gain = 5.0e-8", "gain = 4.8e-8 # 4 % heavier than the model")
    machine = machine.replace("a mass of 10 kg", "a mass of 10.42 kg").replace("10.0 #", "10.42 #")
    files = {
        f"{name}.toml": CAMPAIGN.format(name=name),
        f"{name}_model.toml": PLANT.format(name=f"{name}_model"),
        f"{name}_machine.toml": machine.format(name=f"{name}_machine"),
    }
    for file, text in files.items():
        write_text(folder / file, text)
    return [folder / file for file in files]
