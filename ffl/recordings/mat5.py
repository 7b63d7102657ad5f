"""MAT level 5, read element by element: scipy's reader ends the process on some damaged files."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"
}  # fmt: skip
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _OPAQUE = 2, 17
_NUMERIC = range(6, 16)
_COMPLEX = 8
_OTHER = np.empty((), dtype=object)


def is_mat5(head: bytes) -> bool:
    """By the byte-order mark at the end of the 128-byte header."""
    return len(head) >= 128 and head[126:128] in (b"IM", b"MI")


def parse_mat5(raw: bytes) -> dict[str, np.ndarray]:
    """Numeric arrays by name, fields of structs as `rec.y`; anything else as an object array.

    Raises ValueError or zlib.error on a damaged file. Format: MathWorks, MAT-File Format, level 5.
    """
    order = "<" if raw[126:128] == b"IM" else ">"
    found: dict[str, np.ndarray] = {}
    at = 128
    while at < len(raw):
        element, at = _element(raw, at, order, padded=False)
        if element.kind == _COMPRESSED:
            element, _ = _element(zlib.decompress(element.content), 0, order)
        if element.kind == _MATRIX:
            name, value = _matrix(element.content, order)
            _flatten(name, value, found)
    return found


@dataclass(frozen=True)
class _Element:
    kind: int
    content: bytes


def _element(data: bytes, at: int, order: str, padded: bool = True) -> tuple[_Element, int]:
    """The element at a byte, and where the next one begins."""
    if at + 8 > len(data):
        raise ValueError("the file is cut off")
    first, size = struct.unpack_from(order + "II", data, at)
    if first >> 16:  # up to four bytes, inside the tag itself
        kind, size = first & 0xFFFF, first >> 16
        if size > 4:
            raise ValueError("an element is damaged")
        return _Element(kind, data[at + 4 : at + 4 + size]), at + 8
    start, stop = at + 8, at + 8 + size
    if stop > len(data):
        raise ValueError("the file is cut off")
    return _Element(first, data[start:stop]), stop + (-size % 8 if padded else 0)


def _array(element: _Element, order: str) -> np.ndarray:
    if element.kind not in _NUMBERS:
        raise ValueError(f"numbers of unknown kind {element.kind}")
    return np.frombuffer(element.content, order + _NUMBERS[element.kind])


def _matrix(data: bytes, order: str) -> tuple[str, Any]:
    """(name, array or dict of fields)."""
    if not data:
        return "", np.zeros(0)
    element, at = _element(data, 0, order)
    flags = _array(element, order)
    if len(flags) < 1:
        raise ValueError("an array has no flags")
    kind, is_complex = int(flags[0]) & 0xFF, bool(int(flags[0]) >> 8 & _COMPLEX)
    if kind == _OPAQUE:
        return _text(_element(data, at, order)[0]), _OTHER
    element, at = _element(data, at, order)
    shape = tuple(int(n) for n in _array(element, order))
    element, at = _element(data, at, order)
    name = _text(element)
    if kind == _STRUCT and shape == (1, 1):
        return name, _fields(data, at, order)
    if kind not in _NUMERIC:
        return name, _OTHER
    values = _array(_element(data, at, order)[0], order)
    if min(shape, default=0) < 0 or values.size != np.prod([float(n) for n in shape]):
        raise ValueError(f"'{name}' has {values.size} values in the shape {shape}")
    values = values.reshape(shape, order="F")
    return name, values.astype(complex) if is_complex else values


def _fields(data: bytes, at: int, order: str) -> dict[str, Any]:
    element, at = _element(data, at, order)
    length = int(_array(element, order)[0]) if element.content else 0
    element, at = _element(data, at, order)
    if length < 1:
        return {}
    text = element.content
    names = [text[k : k + length] for k in range(0, len(text), length)]
    fields = {}
    for name in names:
        element, at = _element(data, at, order)
        fields[_text(_Element(1, name))] = _matrix(element.content, order)[1]
    return fields


def _text(element: _Element) -> str:
    return element.content.split(b"\0", 1)[0].decode("latin-1")


def _flatten(name: str, value: Any, into: dict[str, np.ndarray]) -> None:
    if isinstance(value, dict):
        for field, inner in value.items():
            _flatten(f"{name}.{field}", inner, into)
    elif name:
        into[name] = value
