"""What a file is and what it holds: plants, campaigns, step files, mappings, recordings, folders."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ffl.bases import basis_kind
from ffl.campaign.config import (
    Campaign,
    check_campaign,
    check_effects,
    load_campaign,
    load_step,
    run_parts,
)
from ffl.campaign.forms import StepForm
from ffl.campaign.reference import find_map, find_recording
from ffl.campaign.signals import read_dataset
from ffl.campaign.store import read_results
from ffl.effects.stated_mass import mass_said
from ffl.errors import InputError
from ffl.machines import SimulatedMachine, linear_part
from ffl.recordings.readers import READERS
from ffl.systems import Plant, load_plant
from ffl.systems.plant_file import find_plant, read_toml

Facts = dict[str, Any]


def kind_of(table: Mapping[str, Any], path: Path) -> str:
    """ "campaign", "plant", "step" or "mapping", from the tables that only such a file has."""
    marks = {"runs": "campaign", "reference": "campaign", "plant": "plant"}
    marks |= {"basis": "step", "columns": "mapping", "recordings": "mapping"}
    for key, kind in marks.items():
        if key in table:
            return kind
    raise InputError(
        f"{path}: neither a campaign ([[runs]]) nor a plant ([plant]) nor a step file (basis); "
        "add the table that says which"
    )


def check_file(path: Path) -> str:
    """Checks a campaign, plant or step file as `ffl run` would; one sentence where it is sound."""
    if not path.is_file() and not path.is_dir() and path.suffix != ".toml":
        path = find_plant(str(path))
    if path.is_file() and path.suffix.lower() in READERS:
        raise InputError(
            f"{path}: is a recording by its ending, and check reads TOML; what it holds says ffl inspect"
        )
    kind = kind_of(read_toml(path), path)
    if kind == "campaign":
        campaign = load_campaign(path)
        check_campaign(campaign)
        said = (
            f"campaign '{campaign.name}' is sound: {len(campaign.runs)} runs of {campaign.trials} "
            f"trials, {len(campaign.reference)} samples"
        )
        tables = tomllib.loads(campaign.resolved["campaign.toml"])["runs"]
        said += _repeated([(f"runs[{i}].", run["basis"]) for i, run in enumerate(tables)])
        for key, plant in (("model", campaign.model), ("machine", campaign.machine)):
            if wrong := mass_said(plant):
                said += f"; note: {key}: {wrong}"
        return said
    if kind == "plant":
        plant = load_plant(path)
        try:
            check_effects(plant)
            SimulatedMachine(plant)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        try:
            linear_part(plant).require_stable()
        except InputError as error:
            raise InputError(f"{path}: {_culprit(plant)}{error}") from None
        loop = "closed loop stable" if plant.controller is not None else "open loop"
        said = f"plant '{plant.name}' is sound: {loop}, {len(plant.effects)} effects"
        return f"{said}; note: {wrong}" if (wrong := mass_said(plant)) else said
    if kind == "step":
        try:
            return _check_step(load_step(path), path.parent)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    from ffl.recordings import load_mapping

    load_mapping(path)
    return "mapping is sound"


def _culprit(plant: Plant) -> str:
    """The first effect with which the loop, stable without, is stable no more."""
    for index, spec in enumerate(plant.effects):
        try:
            linear_part(replace(plant, effects=plant.effects[: index + 1])).require_stable()
        except InputError:
            return (
                f"effects[{index}] ({spec.name}) takes the loop, stable without it, its stability; "
                "mend its parameters, or the [controller]: "
            )
    return ""


def _repeated(runs: Sequence[tuple[str, Any]]) -> str:
    """A note on tables of a run's basis that are there twice: the data cannot share theta out."""
    for where, tables in runs:
        for k, table in enumerate(tables if isinstance(tables, list) else ()):
            if table in tables[:k]:
                return (
                    f"; note: {where}basis[{k}] repeats basis[{tables.index(table)}]: no trial tells their "
                    "parameters apart; leave one out"
                )
    return ""


def _check_step(form: StepForm, folder: Path) -> str:
    """Which model it is for, only `ffl step` is told: what follows from its effects is left out, and
    the sample time is that of the plants that the file names itself (any serves where there is none)."""
    tables = [] if isinstance(form.basis, str) else form.basis
    known = [t for t in tables if t.get("kind") != "from_diagnosis" or "plant" in t]
    if not known:
        return "step file is sound: its parameters follow from the model's effects"
    named = [load_plant(t["plant"], folder) for t in known if isinstance(t.get("plant"), str)]
    sample_time = named[0].sample_time if named else 1.0
    form = form.model_copy(update={"basis": known})
    count = run_parts(form, sample_time, folder=folder)[0].n_parameters
    rest = " and those of the model's effects" if len(known) < len(tables) else ""
    return f"step file is sound: {count} parameters{rest}{_repeated([('', form.basis)])}"


def inspect_file(path: Path, map: Path | None = None) -> Facts:
    """Facts about a plant, campaign, recording or run folder, ready for JSON."""
    if path.is_dir():
        return _folder(path)
    if path.suffix == ".toml":
        kind = kind_of(read_toml(path), path)
        if kind == "campaign":
            return _campaign(load_campaign(path))
        if kind == "plant":
            try:
                return _plant(load_plant(path))
            except InputError as error:
                text = str(error)
                raise InputError(text if str(path) in text else f"{path}: plant: {text}") from None
        return {"kind": kind, "says": check_file(path)}
    if path.suffix == "" and not path.exists():
        return _plant(load_plant(str(path)))
    if map is None and path.suffix == ".h5" and (path.parent / "results.json").is_file():
        return _signals(path)
    return _recording(path, map)


def _signals(path: Path) -> Facts:
    """The signals of a run, one row a trial, and how a trial is read as a recording."""
    trials = len(read_dataset(path, "error_norm"))
    row = (
        ' = {{ name = "{0}", index = {1} }}' if trials > 1 else ' = "{0}"'
    )  # one trial is one column
    columns = ", ".join(c + row.format(c, trials - 1) for c in "fuy")
    return {
        "kind": "signals of a run",
        "trials": trials,
        "samples": len(read_dataset(path, "time")),
        "as a recording": f'--map FILE with [columns] t = "time", r = "reference", {columns}; index '
        "0 is the first trial",
    }


def _folder(path: Path) -> Facts:
    results = read_results(path)
    facts: Facts = {"kind": "run folder", "campaign": results["campaign"], "seed": results["seed"]}
    for run in results["runs"]:
        norms = run["error_norm"]
        told = f"{run['status']}, {run['parameters']} parameters, {len(norms)} trials"
        if norms:
            told += f", error norm {norms[0]:.4g} to {norms[-1]:.4g}"
        facts[f"run {run['name']}"] = told
    return facts


def _campaign(campaign: Campaign) -> Facts:
    facts: Facts = {
        "kind": "campaign",
        "name": campaign.name,
        "seed": campaign.seed,
        "trials": campaign.trials,
        "model": campaign.model.name,
        "machine": campaign.machine.name,
        "sample_time": campaign.sample_time,
        "samples": len(campaign.reference),
        "reference_range": float(np.ptp(campaign.reference)),
        "reference_peak_velocity": float(
            np.abs(np.diff(campaign.reference)).max() / campaign.sample_time
        ),
    }
    for run in campaign.runs:
        facts[f"run {run.name}"] = (
            f"{basis_kind(run.basis)}, {campaign.parameters(run)} parameters, update {run.update}"
        )
    return facts


def _plant(plant: Plant) -> Facts:
    from ffl.systems import as_zpk

    system = as_zpk(plant.system)
    facts: Facts = {
        "kind": "plant",
        "name": plant.name,
        "sample_time": plant.sample_time,
        "input_unit": plant.input_unit,
        "output_unit": plant.output_unit,
        "poles": [str(complex(p).real if p.imag == 0 else complex(p)) for p in system.poles],
        "zeros": [str(complex(z).real if z.imag == 0 else complex(z)) for z in system.zeros],
        "gain": system.gain,
        "relative_degree": system.relative_degree,
        "zeros_outside_unit_circle": int(np.sum(np.abs(system.zeros) > 1)),
        "effects": [effect.name for effect in plant.effects],
    }
    if wrong := mass_said(plant):
        facts["note"] = wrong
    if plant.controller is not None:
        margins = plant.loop.margins()
        facts["closed_loop_stable"] = plant.loop.is_stable
        facts["largest_closed_loop_pole"] = float(np.abs(plant.loop.poles).max(initial=0.0))
        named = {
            "gain_margin": margins.gain,
            "gain_margin_hz": margins.gain_frequency if np.isfinite(margins.gain) else np.inf,
            "gain_reduction_margin": margins.gain_reduction or np.inf,
            "gain_reduction_margin_hz": margins.gain_reduction_frequency or np.inf,
            "phase_margin_deg": margins.phase,
            "modulus_margin": margins.modulus,
            "crossover_hz": margins.crossover,
        }
        facts |= {name: float(value) for name, value in named.items() if np.isfinite(value)}
    return facts


def _recording(path: Path, map: Path | None) -> Facts:
    from ffl.recordings import read_recording
    from ffl.recordings.sampling import examine_time, other_than_mapped
    from ffl.recordings.soundness import soundness

    mapping = find_map(str(map), Path()) if map is not None else None
    recording = read_recording(find_recording(str(path), Path()), mapping, check=False)
    facts: Facts = {
        "kind": "recording",
        "source": recording.source,
        "samples": len(recording),
        "sample_time": recording.sample_time,
        "duration": recording.duration,
        "not_measured": sorted(recording.missing),
    }
    for name in ("r", "f", "u", "y", "d", "y_load"):
        values = getattr(recording, name)
        if values is not None and np.all(np.isfinite(values)):
            unit = recording.units.get(name, "")
            facts[name] = f"{values.min():.6g} to {values.max():.6g} {unit}".strip()
    if recording.others:  # a diagnosis looks at them too
        facts["other_columns"] = sorted(recording.others)
    found = [f"{finding.severity}: {finding.text}" for finding in soundness(recording).findings]
    if "t" not in recording.missing:  # the mapping's own sample time stands against the column's
        stamped = examine_time(recording.t).sample_time
        wrong = other_than_mapped(stamped, recording.sample_time)
        found = [f"fault: {wrong}", *found] if wrong else found
    if found:
        facts["findings"] = found
    return facts
