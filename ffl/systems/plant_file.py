"""Plant files: TOML at the border, checked key by key, turned into a `Plant` and back."""

from __future__ import annotations

import difflib
import os
import sys
import tomllib
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ffl.errors import InputError
from ffl.systems.atomic import write_text
from ffl.systems.continuous import zero_order_hold
from ffl.systems.findings import of_the_member_meant, plainly
from ffl.systems.loop import Controller
from ffl.systems.plant import EffectSpec, Imperfections, Physics, Plant
from ffl.systems.state_space import StateSpace
from ffl.systems.toml_text import to_toml
from ffl.systems.zpk import Zpk

Root = float | Annotated[list[float], Field(min_length=2, max_length=2)]
Row = list[float]
PLAIN = ("float", "int", "str", "bool")  # as pydantic names them among the members of a union
MOST_DELAY = 3000  # samples; each is a state, and the poles of a loop of so many take 16 s
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class ZpkForm(Strict):
    form: Literal["zpk", "czpk"]
    zeros: list[Root] = []
    poles: list[Root] = []
    gain: float
    delay: Annotated[int, Field(ge=0, le=MOST_DELAY)] = 0

    def build(self, sample_time: float, where: str) -> Zpk | StateSpace:
        zeros = _roots(self.zeros, f"{where}.zeros")
        poles = _roots(self.poles, f"{where}.poles")
        try:
            if self.form == "zpk":
                system = Zpk(zeros, poles, self.gain, sample_time, self.delay)
                if system.relative_degree < 0:
                    raise InputError("more zeros than poles, so it needs the future; add poles")
                return system
            held = zero_order_hold(zeros, poles, self.gain, sample_time)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        return held if not self.delay else _delayed(held, self.delay)


class StateSpaceForm(Strict):
    form: Literal["ss"]
    A: list[Row]
    B: list[Row] | Row
    C: list[Row] | Row
    D: list[Row] | Row | float = 0.0
    delay: Annotated[int, Field(ge=0, le=MOST_DELAY)] = 0

    def build(self, sample_time: float, where: str) -> StateSpace:
        try:
            a = np.atleast_2d(np.array(self.A, float))
            system = StateSpace(
                a, np.array(self.B, float), np.array(self.C, float), self.D, sample_time
            )  # type: ignore[arg-type]
        except (ValueError, InputError) as error:
            raise InputError(f"{where}: {error}; A, B, C, D must have matching shapes") from None
        return system if not self.delay else _delayed(system, self.delay)


SystemForm = Annotated[ZpkForm | StateSpaceForm, Field(discriminator="form")]


class TwoDegreeForm(Strict):
    reference: SystemForm
    output: SystemForm


class UnitsForm(Strict):
    input: str = ""
    output: str = ""


class PhysicsForm(Strict):
    mass: Positive | None = None
    motor_constant: Positive | None = None
    load_mass: Positive | None = None


class MachineForm(Strict):
    encoder_resolution: NotNegative = 0.0
    sensor_noise: NotNegative = 0.0
    force_noise: NotNegative = 0.0
    command_limit: Positive | None = None


class EffectForm(BaseModel):
    model_config = ConfigDict(extra="allow")
    name: str
    parameters: dict[str, Any] = {}


class PlantForm(Strict):
    name: str
    sample_time: Positive
    source: str = ""
    units: UnitsForm = UnitsForm()
    plant: SystemForm
    controller: SystemForm | TwoDegreeForm | None = None
    physics: PhysicsForm = PhysicsForm()
    machine: MachineForm = MachineForm()
    effects: list[EffectForm] = []


def _delayed(system: StateSpace, delay: int) -> StateSpace:
    from ffl.systems.state_space import series

    line = Zpk(np.zeros(0), np.zeros(0), 1.0, system.sample_time, delay).state_space()
    return series(line, system)


def _roots(values: list[Root], where: str) -> np.ndarray:
    roots = [complex(*value) if isinstance(value, list) else complex(value) for value in values]
    for index, root in enumerate(roots):
        if not np.isfinite(root):
            raise InputError(f"{where}[{index}] = {root} is not finite; give a number")
    return np.array(roots, complex)


def suggest(name: str, known: Sequence[str]) -> str:
    """'did you mean X?' where a known name is near, else the list of known names."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(known))}"


def _forms_in(annotation: Any) -> list[Any]:
    """Every form that an annotation may hold, inside lists and unions too."""
    found: list[Any] = []
    queue = [annotation]
    while queue:
        item = queue.pop()
        if hasattr(item, "model_fields"):
            found.append(item)
        queue += list(typing.get_args(item))
    return found


def _place(form: Any, location: tuple[Any, ...]) -> tuple[str, list[str]]:
    """A finding's path as the file spells it, and the keys known at its last table.

    pydantic's location also names the members of unions; those are dropped from the path, and
    choose among the members whose literal they are.
    """
    path, candidates, known = "", [form], sorted(form.model_fields)
    for step in location:
        if isinstance(step, int):
            path += f"[{step}]"
            continue
        if "[" in step or (step in PLAIN and not candidates):  # a member of a union that is no form
            continue
        tagged = [c for c in candidates if _is_tag(c, step)] if len(candidates) > 1 else []
        holders = [c for c in candidates if step in c.model_fields]
        if tagged or (not holders and step != location[-1]):
            candidates = tagged or candidates
            continue
        known = sorted({name for c in (holders or candidates) for name in c.model_fields})
        path += f".{step}" if path else str(step)
        candidates = [f for c in holders for f in _forms_in(c.model_fields[step].annotation)]
    return path, known


def _is_tag(form: Any, tag: str) -> bool:
    literals = (typing.get_args(field.annotation) for field in form.model_fields.values())
    return form.__name__ == tag or any(tag in values for values in literals)


def explain(error: ValidationError, form: Any, file: str) -> InputError:
    """The first finding of pydantic as one line: file, key, what is wrong, how to mend."""
    # A wrong tag is the cause; that its keys are then unknown to the other members follows from it.
    # Of the members of a union the one whose length alone is wrong says more than the others.
    order = ("union_tag_invalid", "union_tag_not_found", "extra_forbidden", "too_long", "too_short")
    finding = min(
        of_the_member_meant(error.errors()), key=lambda f: (*order, f["type"]).index(f["type"])
    )
    location = tuple(step for step in finding["loc"] if "tagged-union" not in str(step))
    path, known = _place(form, location)
    if finding["type"] in order[:2]:
        tag = finding["ctx"]["discriminator"].strip("'")
        tags = [t.strip(" '") for t in finding["ctx"].get("expected_tags", "").split(",") if t]
        if not tags:
            return InputError(f"{file}: key '{path}.{tag}' is missing; add it")
        given = str(finding["ctx"]["tag"])
        return InputError(f"{file}: {path}.{tag} = '{given}': {suggest(given, tags)}")
    if finding["type"] == "extra_forbidden":
        name = str(finding["loc"][-1])
        others = [key for key in known if key != name]
        return InputError(f"{file}: unknown key '{path}'; {suggest(name, others)}")
    if finding["type"] == "missing":
        return InputError(f"{file}: key '{path}' is missing; add it")
    given = finding.get("input")
    shown = f" = {given!r}" if isinstance(given, (int, float, str, bool)) else ""
    return InputError(f"{file}: {path}{shown}: {plainly(str(finding['msg']))}")


def read_toml(path: Path) -> dict[str, Any]:
    """The parsed file, or one line that says what is wrong with it."""
    try:
        text = path.read_bytes().decode(
            "utf-8-sig"
        )  # an editor may have put a byte-order mark first
        return tomllib.loads(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give a TOML file") from None
    except PermissionError:
        raise InputError(f"{path}: cannot be read (permission denied)") from None
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not UTF-8 (byte {error.object[error.start]:#04x} at position {error.start}); save "
            "it as UTF-8"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from None


def shipped_plants() -> Path:
    """The folder of shipped plants: beside the package in a checkout, else where it was installed."""
    beside = Path(__file__).resolve().parents[2] / "plants"
    return beside if beside.is_dir() else Path(sys.prefix) / "share" / "ffl" / "plants"


def find_plant(name_or_path: str | os.PathLike[str], folder: Path | None = None) -> Path:
    """A bare name among the shipped plants, or a path from `folder`, then the working directory."""
    text = os.fspath(name_or_path)
    bare = "/" not in text and os.sep not in text and Path(text).suffix == ""
    tried: list[Path] = []
    if bare:
        tried.append(shipped_plants() / f"{text}.toml")
    for base in ([folder] if folder is not None else []) + [Path()]:
        tried.append(base / text)
        if bare:
            tried.append(base / f"{text}.toml")
    for path in tried:
        if path.is_file():
            return path
    if bare:
        names = sorted(p.stem for p in shipped_plants().glob("*.toml"))
        raise InputError(f"plant '{text}': not among the shipped plants; {suggest(text, names)}")
    raise InputError(
        f"plant file '{text}': no such file (looked in {', '.join(map(str, dict.fromkeys(tried)))})"
    )


def plant_from_dict(data: Mapping[str, Any], file: str = "plant") -> Plant:
    """A `Plant` from parsed TOML; every mistake names `file`, the key and the mend."""
    try:
        form = PlantForm.model_validate(data)
    except ValidationError as error:
        raise explain(error, PlantForm, file) from None
    try:
        system = form.plant.build(form.sample_time, "plant")
        controller = None
        if isinstance(form.controller, TwoDegreeForm):
            controller = Controller(
                form.controller.reference.build(form.sample_time, "controller.reference"),
                form.controller.output.build(form.sample_time, "controller.output"),
            )
        elif form.controller is not None:
            controller = Controller.of_error(form.controller.build(form.sample_time, "controller"))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    return Plant(
        name=form.name,
        system=system,
        controller=controller,
        input_unit=form.units.input,
        output_unit=form.units.output,
        source=form.source,
        physics=Physics(form.physics.mass, form.physics.motor_constant, form.physics.load_mass),
        machine=Imperfections(**form.machine.model_dump()),
        effects=tuple(
            EffectSpec(effect.name, effect.parameters, dict(effect.model_extra or {}))
            for effect in form.effects
        ),
    )


def load_plant(name_or_path: str | os.PathLike[str], folder: Path | None = None) -> Plant:
    """Reads a plant file; `folder` is where a relative path is looked up first."""
    path = find_plant(name_or_path, folder)
    return plant_from_dict(read_toml(path), str(path))


def _system_table(system: Zpk | StateSpace) -> dict[str, Any]:
    if isinstance(system, Zpk):

        def listed(values: np.ndarray) -> list[Any]:
            return [v.real if v.imag == 0 else [v.real, v.imag] for v in values]

        table: dict[str, Any] = {
            "form": "zpk",
            "zeros": listed(system.zeros),
            "poles": listed(system.poles),
            "gain": system.gain,
        }
        if system.delay:
            table["delay"] = system.delay
        return table
    return {
        "form": "ss",
        "A": system.a.tolist(),
        "B": system.b[:, 0].tolist(),
        "C": system.c[0].tolist(),
        "D": float(system.d[0, 0]),
    }


def plant_to_dict(plant: Plant) -> dict[str, Any]:
    """The plant as the file states it; floats round-trip to the last bit."""
    table: dict[str, Any] = {"name": plant.name, "sample_time": plant.sample_time}
    if plant.source:
        table["source"] = plant.source
    table["units"] = {"input": plant.input_unit, "output": plant.output_unit}
    table["plant"] = _system_table(plant.system)
    if plant.controller is not None:
        if plant.controller.one_degree:
            table["controller"] = _system_table(plant.controller.reference)
        else:
            table["controller"] = {
                "reference": _system_table(plant.controller.reference),
                "output": _system_table(plant.controller.output),
            }
    physics = {k: v for k, v in vars(plant.physics).items() if v is not None}
    machine = {k: v for k, v in vars(plant.machine).items() if v}
    if physics:
        table["physics"] = physics
    if machine:
        table["machine"] = machine
    if plant.effects:
        table["effects"] = [
            {"name": e.name, **dict(e.options), "parameters": dict(e.parameters)}
            for e in plant.effects
        ]
    return table


def save_plant(plant: Plant, path: str | os.PathLike[str]) -> None:
    """Writes the plant file aside, then renames it; reading it back gives the same numbers."""
    write_text(Path(path), to_toml(plant_to_dict(plant)))
