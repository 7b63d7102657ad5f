"""state.json of `ffl step`: the parameters after a step, and what they are parameters of."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ffl.bases import BASES
from ffl.campaign.differences import table_differences
from ffl.campaign.store import versions
from ffl.errors import InputError
from ffl.learn.step import Step
from ffl.systems import Plant
from ffl.systems.atomic import write_text
from ffl.systems.state_space import Array

Tables = list[dict[str, Any]] | str


def write_state(
    path: Path, trial: int, step: Step, basis: Tables, model: Plant, recording: str
) -> None:
    """What the next step begins with, and what it is checked by."""
    state = {
        "schema": 1,
        "trial": trial,
        "model": model.name,
        "sample_time": model.sample_time,
        "basis": basis,
        "names": list(step.names),
        "theta": step.theta.tolist(),
        "recording": recording,
        "versions": versions(),
    }
    write_text(path, json.dumps(state, indent=1, allow_nan=False) + "\n")


def read_state(path: Path, names: list[str], basis: Tables, model: Plant) -> tuple[int, Array]:
    """Number of the trial and its parameters from the state.json of the step before.

    Raises `InputError` where they are those of another basis, model or sample time.
    """
    try:
        state = json.loads(path.read_text())
        if state["schema"] != 1 or list(state["names"]) != names:
            raise InputError(
                f"{path}: parameters {', '.join(state['names'])} are not those of the basis "
                f"({', '.join(names)}); give the state of the same basis"
            )
        theta = np.array(state["theta"], float)
        if theta.shape != (len(names),) or not np.all(np.isfinite(theta)):
            raise InputError(f"{path}: theta: give {len(names)} finite numbers")
        _require_same(path, state, basis, model)
        return int(state["trial"]), theta
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the state.json in it") from None
    except InputError:
        raise
    except (ValueError, KeyError, TypeError) as error:
        what = f"there is no {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(
            f"{path}: not a state that 'ffl step' wrote ({what}); give its state.json"
        ) from None


def _require_same(path: Path, state: Mapping[str, Any], basis: Tables, model: Plant) -> None:
    away = "or leave --state out to learn from zero"
    period = float(state["sample_time"])
    if not abs(period / model.sample_time - 1.0) <= 1e-9:
        raise InputError(
            f"{path}: sample_time is {period:g} s there and {model.sample_time:g} s in model "
            f"'{model.name}'; give the state of the same model, {away}"
        )
    if state["model"] != model.name:
        raise InputError(
            f"{path}: learned with model '{state['model']}', and this is model '{model.name}'; give "
            f"--model {state['model']}, {away}"
        )
    there, here = _filled(state["basis"]), _filled(basis)
    differs = table_differences(there, here, "basis") or table_differences(here, there, "basis")
    if differs:
        more = f" and {len(differs) - 1} more" if len(differs) > 1 else ""
        raise InputError(
            f"{path}: {differs[0]}{more} is not that of the basis file, so the parameters mean "
            f"something else; give the state of the same basis, {away}"
        )


def _filled(basis: Any) -> Any:
    """The tables with the defaults written out, as JSON has them."""
    if not isinstance(basis, list):
        return basis
    return json.loads(json.dumps([_defaults(table) | dict(table) for table in basis]))


def _defaults(table: Mapping[str, Any]) -> dict[str, Any]:
    parameters = inspect.signature(BASES[table["kind"]]).parameters.values()
    written = (p for p in parameters if p.default is not p.empty and p.name != "sample_time")
    return {p.name: p.default for p in written if not isinstance(p.default, Plant)}
