"""Campaign files: TOML at the border, checked key by key, turned into a `Campaign`."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.random import SeedSequence
from pydantic import BaseModel, ValidationError

from ffl.bases import Basis, FreeSignal, make_basis
from ffl.campaign.forms import (
    CampaignForm,
    ConstraintsForm,
    FileForm,
    RunForm,
    StepForm,
    WeightsForm,
)
from ffl.campaign.reference import build_reference, check_rest
from ffl.errors import InputError
from ffl.learn import Constraints, LearningTask, Weights
from ffl.machines import SimulatedMachine
from ffl.systems import Plant, Zpk, load_plant, plant_to_dict
from ffl.systems.plant_file import ZpkForm, explain, read_toml, suggest
from ffl.systems.state_space import Array
from ffl.systems.toml_text import to_toml

Form = TypeVar("Form", bound=BaseModel)
T = TypeVar("T")


@dataclass(frozen=True)
class RunSpec:
    """One `[[runs]]` table: how to learn."""

    name: str
    basis: Basis
    weights: Weights
    constraints: Constraints = field(default_factory=Constraints)
    update: str = "auto"


@dataclass(frozen=True)
class Campaign:
    """A campaign as read: plants, references, runs; `resolved` are the files that rerun it.

    `second_reference` is run once after the last trial with the learned parameters carried over.
    `diagnosis` are references to record for a diagnosis: those to fit and those to hold out. `file`
    is where it was read, for messages.
    """

    name: str
    seed: int
    trials: int
    model: Plant
    machine: Plant
    reference: Array
    second_reference: Array | None
    runs: tuple[RunSpec, ...]
    resolved: Mapping[str, str]
    diagnosis: tuple[tuple[Array, ...], tuple[Array, ...]] | None = None
    file: str = ""

    @property
    def sample_time(self) -> float:
        return self.model.sample_time

    @property
    def time(self) -> Array:
        return np.arange(len(self.reference)) * self.sample_time

    def task(self, run: RunSpec) -> LearningTask:
        machine = SimulatedMachine(self.machine)
        return LearningTask(
            self.model, machine, run.basis, self.reference, run.weights, run.constraints, run.update
        )

    def parameters(self, run: RunSpec) -> int:
        """How many values a run learns; a free signal has one per sample."""
        free = isinstance(run.basis, FreeSignal)
        return len(self.reference) if free else run.basis.n_parameters

    def seed_of(self, run: RunSpec) -> SeedSequence:
        """Noise of a run: from the campaign's seed and the run's name, whatever runs beside it."""
        digest = hashlib.sha256(run.name.encode()).digest()
        key = tuple(int.from_bytes(digest[k : k + 4], "little") for k in (0, 4))
        return SeedSequence(self.seed, spawn_key=key)

    def run(self, name: str) -> RunSpec:
        for run in self.runs:
            if run.name == name:
                return run
        known = suggest(name, [run.name for run in self.runs])
        raise InputError(f"run '{name}' is not in campaign '{self.name}'; {known}")


def load_campaign(path: str | os.PathLike[str], seed: int | None = None) -> Campaign:
    """Reads and checks a campaign; `seed` replaces the file's. Every mistake is one line that names
    the file and the key."""
    path = Path(path)
    table = read_toml(path)
    form = validated(table, CampaignForm, str(path))
    if seed is not None:
        if seed < 0:
            raise InputError(f"seed = {seed} must not be negative")
        form = form.model_copy(update={"seed": seed})
    folder = path.parent
    model = _in_file(path, "model", lambda: load_plant(form.model, folder))
    machine = _in_file(path, "machine", lambda: load_plant(form.machine or form.model, folder))
    _in_file(path, "model", model.require_stable)
    _in_file(path, "machine", machine.require_stable)
    if model.controller is None and machine.controller is not None:
        raise InputError(
            f"{path}: model '{model.name}' has no [controller] and machine '{machine.name}' has one: "
            "the update would take the loop for open; copy the [controller] into the model"
        )
    if abs(machine.sample_time / model.sample_time - 1.0) > 1e-9:
        raise InputError(
            f"{path}: machine '{machine.name}' has sample_time = {machine.sample_time:g} s, model "
            f"'{model.name}' {model.sample_time:g} s; give both the same"
        )
    for key, plant in (("model", model), ("machine", machine)):
        name = getattr(form, key) or form.model
        _in_file(path, f"{key} = '{name}'", partial(check_effects, plant))
    references = {
        key: _in_file(path, "", partial(_reference, getattr(form, key), model, folder, key))
        for key in ("reference", "second_reference")
        if getattr(form, key) is not None
    }
    diagnosis = None
    if form.diagnosis is not None:
        fit, held_out = (
            tuple(
                _in_file(path, "", partial(_reference, r, model, folder, f"diagnosis.{key}[{k}]"))
                for k, r in enumerate(getattr(form.diagnosis, key))
            )
            for key in ("fit", "held_out")
        )
        diagnosis = (fit, held_out)
    names = [run.name for run in form.runs]
    for index, name in enumerate(names):
        if name.lower() in (other.lower() for other in names[:index]):  # each is a file
            raise InputError(
                f"{path}: runs[{index}].name = '{name}' is used twice, in whatever case; rename one"
            )
    runs = tuple(
        _in_file(path, f"runs[{index}]", partial(_run_spec, run, model, folder))
        for index, run in enumerate(form.runs)
    )
    resolved = _resolved(form, model, machine, references, folder)
    return Campaign(
        form.name,
        form.seed,
        form.trials,
        model,
        machine,
        references["reference"],
        references.get("second_reference"),
        runs,
        resolved,
        diagnosis,
        str(path),
    )


def check_campaign(campaign: Campaign) -> None:
    """What a run would refuse, found without running: regressors, weights' lengths, bounds."""
    for index, run in enumerate(campaign.runs):
        try:
            campaign.task(run).updater()
            _check_feasible(campaign, run)
            if campaign.second_reference is not None and not isinstance(run.basis, FreeSignal):
                run.basis.regressors(campaign.second_reference)
        except (InputError, OverflowError, MemoryError) as error:
            where = f"{campaign.file}: " if campaign.file else ""
            raise InputError(f"{where}runs[{index}] ({run.name}): {error}") from None


def _check_feasible(campaign: Campaign, run: RunSpec) -> None:
    """Bounds that exclude one another whatever the trial brings are bad input, not an outcome; the
    command's depend on the trial, so the others are tried without them, and on the linear part."""
    fixed = replace(run.constraints, command=None)
    n, free = len(campaign.reference), isinstance(run.basis, FreeSignal)
    count = campaign.parameters(run)
    names = [name for name in Constraints.NAMES if getattr(fixed, name) is not None]
    limits = [fixed.limits(name, count if name == "parameters" else n) for name in names]
    if all(np.all(low <= 0) and np.all(high >= 0) for low, high in limits):
        return
    linear = replace(run, constraints=fixed, update=run.update if free else "osqp")
    error = campaign.reference if free else np.zeros(n)  # a free signal takes its scale from it
    report = campaign.task(linear).updater().update(np.zeros(count), error).report
    if report.status == "infeasible":
        raise InputError(f"constraints: {report.message}")


def check_effects(plant: Plant) -> None:
    """Raises `InputError` where an effect's name or parameters are not in the catalogue."""
    if plant.effects:
        from ffl.effects import effect_of

        for index, spec in enumerate(plant.effects):
            try:
                effect_of(spec).check(spec)
            except InputError as error:
                raise InputError(f"effects[{index}]: {error}") from None


def load_step(path: str | os.PathLike[str]) -> StepForm:
    """The file of `ffl step --basis`."""
    return validated(read_toml(Path(path)), StepForm, str(path))


def run_parts(
    form: RunForm | StepForm, sample_time: float, model: Plant | None = None, folder: Path = Path()
) -> tuple[Basis, Weights, Constraints]:
    """Basis, weights and constraints of a run's tables, built and checked; a basis that asks for a
    `plant` gets the file it names (looked for in `folder` too), or else `model`."""
    try:
        basis = make_basis(_with_plants(form.basis, folder), sample_time, model)
    except (InputError, OverflowError, MemoryError) as error:
        text = str(error)
        raise InputError(f"basis{'' if text.startswith('[') else ': '}{text}") from None
    return basis, _weights(form.weights, sample_time), _constraints(form.constraints)


def _with_plants(basis: list[dict[str, Any]] | str, folder: Path) -> list[dict[str, Any]] | str:
    """The basis tables with the plants that they name in place of the names."""
    if isinstance(basis, str):
        return basis
    return [
        spec | {"plant": load_plant(spec["plant"], folder)}
        if isinstance(spec.get("plant"), str)
        else spec
        for spec in basis
    ]


def validated(table: Mapping[str, Any], form: type[Form], file: str) -> Form:
    try:
        return form.model_validate(table)
    except ValidationError as error:
        raise explain(error, form, file) from None


def _in_file(path: Path, where: str, build: Callable[[], T]) -> T:
    try:
        return build()
    except InputError as error:
        text = str(error)
        joint = "." if where.startswith("runs") else ": "
        raise InputError(f"{path}: {where}{joint if where else ''}{text}") from None


def _reference(form: Any, model: Plant, folder: Path, key: str) -> Array:
    try:
        reference = build_reference(form, model.sample_time, folder)
        check_rest(reference)
    except InputError as error:
        raise InputError(str(error).replace("reference", key, 1)) from None
    return reference


def _run_spec(form: RunForm, model: Plant, folder: Path) -> RunSpec:
    return RunSpec(form.name, *run_parts(form, model.sample_time, model, folder), form.update)


def _weights(form: WeightsForm, sample_time: float) -> Weights:
    values: dict[str, Any] = {}
    for name in ("error", "feedforward", "feedforward_change"):
        value, where = getattr(form, name), f"weights.{name}"
        if isinstance(value, Mapping):
            filter_form = validated(value, ZpkForm, where)
            built = filter_form.build(sample_time, where)
            if not isinstance(built, Zpk):
                raise InputError(f"{where}.form = 'czpk': give the filter in discrete time, 'zpk'")
            values[name] = built
        else:
            values[name] = _numbers(value, where)
    return Weights(**values)


def _constraints(form: ConstraintsForm) -> Constraints:
    values: dict[str, Any] = {}
    for name in Constraints.NAMES:
        value, where = getattr(form, name), f"constraints.{name}"
        if value is None:
            continue
        numbers = _numbers(value, where)
        shape = np.shape(numbers)
        if shape not in ((), (2,)) and (len(shape) != 2 or shape[0] != 2):
            raise InputError(f"{where}: give a number, [low, high], or two lists: lows and highs")
        values[name] = numbers
        if len(shape) < 2:
            Constraints(**{name: numbers}).limits(name, 1)
    return Constraints(**values)


def _numbers(value: Any, where: str) -> float | Array:
    """A number or an array of numbers; TOML strings, booleans and ragged lists are refused."""
    flat = np.ravel(np.array(value, dtype=object)) if isinstance(value, list) else [value]
    if any(isinstance(v, (str, bool, list, dict)) or not isinstance(v, (int, float)) for v in flat):
        raise InputError(f"{where} = {str(value)[:60]!r}: give a number or lists of numbers")
    try:
        numbers = np.asarray(value, float)
    except ValueError:
        raise InputError(f"{where}: lists of different length; give rows of equal length") from None
    return float(numbers) if numbers.ndim == 0 else numbers


def _resolved(
    form: CampaignForm,
    model: Plant,
    machine: Plant,
    references: Mapping[str, Array],
    folder: Path,
) -> dict[str, str]:
    """Files that rerun the campaign anywhere: defaults filled in, plants and recordings beside it."""
    table = form.model_dump(exclude_none=True)
    table |= {"model": "model.toml", "machine": "machine.toml"}
    files: dict[str, str] = {}
    for key, signal in references.items():
        if isinstance(getattr(form, key), FileForm):
            table[key] = {"kind": "file", "file": f"{key}.csv", "column": "r"}
            rows = (f"{k * model.sample_time!r},{float(value)!r}" for k, value in enumerate(signal))
            files[f"{key}.csv"] = "t,r\n" + "\n".join(rows) + "\n"
    for i, run in enumerate(form.runs):
        for j, spec in enumerate(run.basis if isinstance(run.basis, list) else []):
            if isinstance(spec.get("plant"), str):
                name = f"basis_{i}_{j}.toml"
                files[name] = to_toml(plant_to_dict(load_plant(spec["plant"], folder)))
                table["runs"][i]["basis"][j]["plant"] = name
    return {
        "campaign.toml": to_toml(table),
        "model.toml": to_toml(plant_to_dict(model)),
        "machine.toml": to_toml(plant_to_dict(machine)),
    } | files
