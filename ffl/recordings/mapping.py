"""Mapping files: which names, scales and units of a foreign file are t, r, f, u, y, d and y_load."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic import model_validator as validated

from ffl.errors import InputError
from ffl.systems.plant_file import explain, read_toml, shipped_plants, suggest

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _named(value: Any) -> Any:
    """A bare name stands for {name = ...}."""
    return {"name": value} if isinstance(value, str) else value


class Term(Strict):
    """(scale · values + offset) · product of `times`, values = the file's array `name`."""

    name: str
    index: Annotated[int, Field(ge=0)] | None = None
    scale: Number = 1.0
    offset: Number = 0.0
    times: tuple[Annotated[Term, BeforeValidator(_named)], ...] = ()

    @validated(mode="before")
    @classmethod
    def _one_factor(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("times"), str | dict):
            return {**data, "times": [data["times"]]}
        return data


class Column(Term):
    """A term with a unit; or a constant; or a sum of terms. `optional`: as if it were not mapped where
    the file lacks what it names."""

    name: str = ""
    constant: Number | None = None
    sum: tuple[Annotated[Term, BeforeValidator(_named)], ...] = ()
    unit: str | None = None
    optional: bool = False

    @validated(mode="after")
    def _one_source(self) -> Column:
        given = (bool(self.name), self.constant is not None, bool(self.sum))
        if given.count(True) != 1:
            raise ValueError("give exactly one of name, constant and sum")
        changed = self.index is not None or self.scale != 1.0 or self.offset != 0.0 or self.times
        if not self.name and changed:
            raise ValueError("index, scale, offset and times go with name")
        if self.optional and self.constant is not None:
            raise ValueError("a constant is always there; leave optional out")
        return self

    @property
    def terms(self) -> tuple[Term, ...]:
        return self.sum or ((self,) if self.name else ())


Entry = Annotated[Column, BeforeValidator(_named)]


class Columns(Strict):
    t: Entry | None = None
    r: Entry | None = None
    f: Entry | None = None
    u: Entry | None = None
    y: Entry | None = None
    d: Entry | None = None
    y_load: Entry | None = None


def _in_order(rows: tuple[int, ...] | None) -> tuple[int, ...] | None:
    if rows is not None and (rows[0] < 0 or (len(rows) == 2 and 0 <= rows[1] <= rows[0])):
        raise ValueError("give [start] or [start, stop] with 0 <= start < stop")
    return rows


Rows = Annotated[
    Annotated[tuple[int, ...], Field(min_length=1, max_length=2)] | None, AfterValidator(_in_order)
]


class Part(Strict):
    """One of several recordings in a file; what it does not say is taken from the top level."""

    name: Annotated[str, Field(min_length=1)]
    columns: Columns = Columns()
    rows: Rows = None
    sample_time: Positive | None = None


class Mapping(Strict):
    """A whole mapping file. See docs/recordings.md."""

    about: str = ""
    sample_time: Positive | None = None
    start: Number = 0.0
    rows: Rows = None
    header: tuple[str, ...] = ()
    skip_lines: Annotated[int, Field(ge=0)] = 0
    default: str | None = None
    columns: Columns = Columns()
    recordings: tuple[Part, ...] = ()

    @validated(mode="after")
    def _names(self) -> Mapping:
        names = [part.name for part in self.recordings]
        if len(set(names)) < len(names):
            raise ValueError("two recordings have one name; rename one")
        if self.default is not None and self.default not in names:
            raise ValueError(f"default is none of the recordings ({', '.join(names) or 'none'})")
        return self

    def part(self, name: str | None) -> Part:
        """One recording with everything filled in from the top level."""
        chosen = next((p for p in self.recordings if p.name == name), None)
        columns = {n: getattr(self.columns, n) for n in Columns.model_fields}
        if chosen is None:
            return Part(
                name=name or "all",
                columns=self.columns,
                rows=self.rows,
                sample_time=self.sample_time,
            )
        own = {n: getattr(chosen.columns, n) for n in Columns.model_fields}
        columns |= {n: column for n, column in own.items() if column is not None}
        return Part(
            name=chosen.name,
            columns=Columns(**columns),
            rows=chosen.rows or self.rows,
            sample_time=chosen.sample_time or self.sample_time,
        )


def load_mapping(name_or_path: str | Path) -> Mapping:
    """A mapping file by its path, or by the bare name of a shipped one (plants/maps/).

    Raises `InputError` naming file, key and mend; an unknown key comes with a suggestion.
    """
    path = Path(name_or_path)
    if not path.is_file() and path.suffix == "" and len(path.parts) == 1:
        folder = shipped_plants() / "maps"
        path = folder / f"{name_or_path}.toml"
        if not path.exists():
            names = sorted(p.stem for p in folder.glob("*.toml"))
            raise InputError(
                f"mapping '{name_or_path}': no such file, and not among the shipped mappings; "
                f"{suggest(str(name_or_path), names)}"
            )
    content = read_toml(path)
    try:
        return Mapping.model_validate(content)
    except ValidationError as error:
        raise explain(error, Mapping, str(path)) from None


def mapping_beside(path: Path) -> Mapping | None:
    """The mapping NAME.map.toml that lies beside the recording NAME.ext, where there is one."""
    file = mapping_file_beside(path)
    return None if file is None else load_mapping(file)


def mapping_file_beside(path: Path) -> Path | None:
    names = (f"{path.stem}.map.toml", f"{path.name}.map.toml")
    return next((p for name in names if (p := path.with_name(name)).is_file()), None)
