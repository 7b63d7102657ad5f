"""Verbs of learning: run, report, step, export, and what files hold."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ffl.cli.app import Json, Map, Out, Quiet, app, print_json
from ffl.errors import WorkError


@app.command()
def run(
    campaign: Annotated[Path, typer.Argument(help="Campaign file.")],
    out: Out = None,
    jobs: Annotated[int, typer.Option(help="Worker processes.")] = 1,
    resume: Annotated[bool, typer.Option(help="Go on in an existing folder.")] = False,
    seed: Annotated[int | None, typer.Option(help="Replaces the campaign's seed.")] = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run a learning campaign: trials, signals, results.json and report.html in one folder."""
    from ffl.campaign import load_campaign
    from ffl.report.learning import run_with_report

    outcome = run_with_report(load_campaign(campaign, seed), out, jobs, resume, quiet)
    if json:
        print_json(outcome.results)
    elif any(entry["error_norm"] for entry in outcome.results["runs"]):
        from ffl.report.learning import print_summary

        print_summary([outcome.folder])
        print(f"\nreport: {outcome.folder / 'report.html'}")
    if outcome.stopped:
        raise WorkError("; ".join(f"run '{name}' stopped: {why}" for name, why in outcome.stopped))


@app.command()
def rerun(
    folder: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    out: Out = None,
    jobs: Annotated[int, typer.Option(help="Worker processes.")] = 1,
    quiet: Quiet = False,
) -> None:
    """Run a folder's resolved campaign again and say whether every number comes out the same:
    results.json but for wall times, and the signals in the .h5 files."""
    from ffl.report.learning import rerun_folder

    same = rerun_folder(folder, out, jobs, quiet)
    if not same:
        raise WorkError(f"{folder}: the numbers differ from those on disk (see versions)")


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="Campaign or plant file.")], json: Json = False
) -> None:
    """Check a campaign or plant file without running it."""
    from ffl.campaign.inspect import check_file

    said = check_file(file)
    if json:
        print_json({"schema": 1, "file": str(file), "valid": True, "says": said})
    else:
        print(f"{file}: {said}")


@app.command()
def report(
    folders: Annotated[list[Path], typer.Argument(help="Folders of finished runs.")],
    out: Out = None,
) -> None:
    """One report from one or more finished runs."""
    from ffl.report.learning import own_report, print_summary, write_report
    from ffl.systems.atomic import require_replaceable

    name = "report.html" if len(folders) == 1 else "comparison.html"
    if out is None:  # of several folders into the working directory, said in full
        target = folders[0] / name if len(folders) == 1 else Path.cwd() / name
    else:  # a folder, or a file by its ending
        target = out / name if out.is_dir() or out.suffix == "" else out
    require_replaceable(target, own_report)
    write_report(folders, target)
    print_summary(folders)
    print(f"\nreport: {target}")


@app.command()
def step(
    model: Annotated[Path, typer.Option(help="Plant file of the model.")],
    basis: Annotated[Path, typer.Option(help="TOML with `basis` and `weights`.")],
    trial: Annotated[Path, typer.Option(help="Recording of the trial.")],
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    map: Map = None,
    state: Annotated[
        Path | None, typer.Option(help="state.json that the step before wrote.")
    ] = None,
    check: Annotated[
        list[Path] | None,
        typer.Option(help="Recording that teaches nothing; the model foretells its next error."),
    ] = None,
    check_map: Annotated[Path | None, typer.Option(help="Mapping of the --check files.")] = None,
    json: Json = False,
) -> None:
    """One learning step on a real machine's recording: next feedforward and new state."""
    from ffl.report.step import error_told, relative, step_with_report
    from ffl.report.terminal import print_table, working

    with working("step"):
        answer = step_with_report(model, basis, trial, out, map, state, check or (), check_map)
    if json:
        print_json(answer)
        return
    rows = [[p["name"], p["value"], error_told(p)] for p in answer["parameters"]]
    print_table(["parameter", "value", "std error (noise)"], rows)
    for note in answer["notes"]:
        print(f"note: {note}")
    for name, entry in answer.get("documented", {}).items():
        print(
            f"{name}: documented {entry['documented']:g}, learned {entry['learned']:.4g} "
            f"({relative(entry)})"
        )
    for entry in answer.get("foretold", ()):
        print(
            f"{entry['recording']}: RMS error measured {entry['measured']:.4g}, model as recorded "
            f"{entry['before']:.4g}, with the next feedforward {entry['after']:.4g}"
        )
    print(f"\nnext feedforward: {out / 'feedforward.csv'}\nreport: {out / 'report.html'}")


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(help="Folder of a finished run.")],
    run: Annotated[str, typer.Option("--run", help="Name of the run.")],
    format: Annotated[str, typer.Option("--format", help="json, c, mat or csv.")],
    out: Annotated[Path, typer.Option("--out", help="File to write.")],
) -> None:
    """Write a learned feedforward as sections (JSON), C header, MAT file or table."""
    from ffl.campaign.export import export_run

    export_run(folder, run, format, out)
    print(out)


@app.command()
def inspect(
    file: Annotated[Path, typer.Argument(help="Plant, campaign, recording or run folder.")],
    map: Map = None,
    json: Json = False,
) -> None:
    """Say what a plant, campaign, recording or run folder holds."""
    from ffl.campaign.inspect import inspect_file

    facts = inspect_file(file, map)
    if json:
        print_json(facts)
        return
    from ffl.report.terminal import print_table

    told = {
        k: ", ".join(str(item) for item in v) if isinstance(v, list) else v
        for k, v in facts.items()
    }
    print_table(["what", "value"], [[k, v] for k, v in told.items()])


@app.command()
def init(folder: Annotated[Path, typer.Argument(help="Folder to make.")]) -> None:
    """Make a folder with a plant and a campaign to start from."""
    from ffl.campaign.templates import init_folder

    for path in init_folder(folder):
        print(path)


@app.command()
def new(
    what: Annotated[str, typer.Argument(help="effect, basis or plant.")],
    name: Annotated[str, typer.Argument(help="Its name, in lower case with underscores.")],
    out: Out = None,
) -> None:
    """Write the file a new effect, basis or plant starts from, and say how to register it."""
    from ffl.campaign.templates import new_file

    path, says = new_file(what, name, out or Path())
    print(path)
    if says:
        print(says, file=sys.stderr)
