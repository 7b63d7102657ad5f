"""Verbs that work from recordings and papers: identify, diagnose, reproduce."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ffl.cli.app import Json, Map, Out, Quiet, app, print_json


@app.command()
def identify(
    method: Annotated[
        str,
        typer.Argument(help="linear, least_squares, kernel, rational, bayes or instrumental."),
    ],
    data: Annotated[list[Path], typer.Option(help="Recording; may be given more than once.")],
    map: Map = None,
    model: Annotated[
        Path | None, typer.Option(help="Plant file whose controller closed the loop.")
    ] = None,
    basis: Annotated[
        Path | None, typer.Option(help="TOML with `basis` and `weights`, for instrumental.")
    ] = None,
    n_ac: Annotated[
        int | None, typer.Option(help="Taps that look ahead: lags from -N; 50 if not given.")
    ] = None,
    n_c: Annotated[
        int | None, typer.Option(help="Taps that look back: lags up to N; 50 if not given.")
    ] = None,
    order: Annotated[
        list[int] | None, typer.Option(help="Order to try, may be repeated; for linear.")
    ] = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Identify an inverse system, or a forward linear model as a plant file, from recordings."""
    from ffl.report.identify import identify_with_report
    from ffl.report.terminal import print_table, working

    with working(f"identify {method}"):
        answer = identify_with_report(
            method, data, map, model, basis, n_ac, n_c, order or None, out
        )
    if json:
        print_json(answer)
        return
    for name, value in answer.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            print(f"\n{name}")
            print_table(list(value[0]), [[row.get(k) for k in value[0]] for row in value])
        elif not isinstance(value, (list, dict)):
            print(f"{name}: {value:.6g}" if isinstance(value, float) else f"{name}: {value}")
    for note in answer["notes"]:
        print(f"\nnote: {note}")
    if out is not None:
        used = "plant.toml" if method == "linear" else "basis.toml"
        print(f"\nfor a campaign: {out / used}\nreport: {out / 'report.html'}")


@app.command()
def diagnose(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings to learn from.")],
    model: Annotated[Path, typer.Option(help="Plant file of the model.")],
    validate: Annotated[
        list[Path] | None, typer.Option(help="Recording that only judges; may be repeated.")
    ] = None,
    map: Map = None,
    out: Out = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Locate, name, model and prove what the model leaves out of the recordings."""
    from ffl.campaign.reference import find_recording
    from ffl.report.diagnosis import diagnose_with_report, print_answer
    from ffl.systems.atomic import require_own

    if out is not None:
        require_own(out, "verdict")
    here = Path()
    found = [find_recording(str(path), here) for path in recordings]
    judging = [find_recording(str(path), here) for path in validate or ()]
    answer = diagnose_with_report(model, found, judging, map, out, quiet)
    if json:
        print_json(answer)
    else:
        print_answer(answer)
        if out is not None:
            print(f"\nreport: {out / 'report.html'}")


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(help="printer2018, kernel2018, bayes2025 or papers_gap.")],
    fast: Annotated[bool, typer.Option("--fast", help="Fewer realisations; says so.")] = False,
    out: Out = None,
    jobs: Annotated[int, typer.Option(help="Worker processes; the numbers stay the same.")] = 1,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Reproduce a paper's tables and figures beside the paper's own."""
    from ffl.report.reproduce import reproduce_paper

    answer = reproduce_paper(paper, fast, out, jobs, quiet)
    if json:
        print_json(answer)
        return
    from ffl.report.terminal import print_table

    columns = ("key", "what", "paper", "ours", "unit", "std_error", "n")
    print_table(columns, [[row.get(name) for name in columns] for row in answer["rows"]])
