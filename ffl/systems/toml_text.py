"""TOML text for the tables the project writes (the standard library only reads TOML)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

BARE_KEY = re.compile(r"^[A-Za-z0-9_-]+$")


def _key(name: str) -> str:
    return name if BARE_KEY.match(name) else json.dumps(name)


def inline(value: Any) -> str:
    """One value on one line, tables as { ... }."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {inline(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(inline(item) for item in value) + "]"
    number = float(value)
    if math.isfinite(number):
        return repr(number)
    return "nan" if math.isnan(number) else ("inf" if number > 0 else "-inf")


def _is_table_array(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, Mapping) for v in value)


def to_toml(table: Mapping[str, Any], prefix: str = "") -> str:
    """`table` as TOML: plain keys first, then tables, then arrays of tables; floats exactly."""
    lines: list[str] = []
    later: list[tuple[str, Any]] = []
    for name, value in table.items():
        if isinstance(value, Mapping) or (_is_table_array(value) and not prefix):
            later.append((name, value))
        else:
            lines.append(f"{_key(name)} = {inline(value)}")
    text = "\n".join(lines) + ("\n" if lines else "")
    for name, value in later:
        full = f"{prefix}{_key(name)}"
        if isinstance(value, Mapping):
            text += f"\n[{full}]\n{to_toml(value, full + '.')}"
            continue
        for item in value:
            inner = "\n".join(f"{_key(k)} = {inline(v)}" for k, v in item.items())
            text += f"\n[[{full}]]\n{inner}\n"
    return text
