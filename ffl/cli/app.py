"""The parser and the options that verbs share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    name="ffl",
    help="Feedforward learning, inverse identification and diagnosis for machines that repeat motion.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _told_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"ffl {version('ffl')}")
        raise typer.Exit


@app.callback()
def ffl(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_told_version, is_eager=True, help="Say which it is."),
    ] = False,
) -> None:
    """Feedforward learning, inverse identification and diagnosis for machines that repeat motion."""


Out = Annotated[Path | None, typer.Option("--out", help="Folder or file to write.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress on stderr.")]
Map = Annotated[
    Path | None, typer.Option("--map", help="TOML that maps column names, units and signs.")
]


def print_json(document: Any) -> None:
    print(json.dumps(document, indent=1, allow_nan=False))
