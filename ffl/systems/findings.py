"""pydantic's findings about a file, in the words of these files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def of_the_member_meant(findings: Sequence[Any]) -> list[Any]:
    """Of a union's findings those of the member whose tag was given and known, where there is one: that
    the other members know nothing of its keys is no mistake."""
    meant: list[tuple[Any, ...]] = []
    for finding in findings:
        where = finding["loc"]
        at = [k for k, step in enumerate(where) if "tagged-union" in str(step)]
        if at and not finding["type"].startswith("union_tag"):
            meant.append(where[: at[0] + 1])
    return [
        finding
        for finding in findings
        if not any(
            finding["loc"][: len(m) - 1] == m[:-1] and finding["loc"][: len(m)] != m for m in meant
        )
    ]


WORDS = (
    ("Value error, ", ""),
    ("Input should be greater than or equal to", "must be at least"),
    ("Input should be less than or equal to", "must be at most"),
    ("Input should be a valid integer", "must be a whole number"),
    ("Input should be a valid number", "must be a number"),
    ("Input should be a finite number", "must be finite"),
    ("Input should be a valid string", "must be a text in quotes"),
    ("Input should be a valid boolean", "must be true or false"),
    ("Input should be a valid dictionary or instance of", "must be a table:"),
    ("Input should be a valid list", "must be a list"),
    ("Input should be a valid tuple", "must be a list"),
    ("Input should", "must"),
    ("String should", "must"),
)


def plainly(message: str) -> str:
    """pydantic's message in the words of these files."""
    for theirs, ours in WORDS:
        message = message.replace(theirs, ours)
    return message.replace("\n", " ")
