"""The blind test: make, solve, score."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ffl.cli.app import Json, Quiet, app, print_json

challenge = typer.Typer(help="The project's own blind test: make, solve, score.")
app.add_typer(challenge, name="challenge")


@challenge.command("make")
def challenge_make(
    out: Annotated[Path, typer.Option(help="Folder for the recordings and plant files.")],
    truth: Annotated[Path, typer.Option(help="Folder for the truth, apart from the cases.")],
    seed: Annotated[int, typer.Option(help="Seed; a blind seed is used once.")],
    fraction: Annotated[float, typer.Option(help="Share of the full composition.")] = 1.0,
    jobs: Annotated[int, typer.Option(help="Worker processes.")] = 1,
    json: Json = False,
) -> None:
    """Make concealed recordings and their truth, and publish the hashes (commitments.json)."""
    from ffl.challenge import make

    document = make(out, truth, seed, fraction, jobs)
    if json:
        print_json(document)
        return
    print(f"{sum(document['counts'].values())} cases in {out}: {document['counts']}")
    print(f"root hash to publish before solving: {document['root']}")


@challenge.command("solve")
def challenge_solve(
    cases: Annotated[Path, typer.Argument(help="Folder of cases.")],
    out: Annotated[Path, typer.Option(help="Folder for the answers; goes on where it stopped.")],
    jobs: Annotated[int, typer.Option(help="Diagnoses at a time.")] = 1,
    quiet: Quiet = False,
) -> None:
    """Run the shipped diagnosis on every case that has no answer yet."""
    from ffl.challenge import solve

    def say(done: int, total: int) -> None:
        print(f"\rffl: {done} of {total} cases", end="", file=sys.stderr, flush=True)

    count = solve(cases, out, jobs, progress=None if quiet else say)
    if count and not quiet:
        print(file=sys.stderr)
    print(f"{count} cases answered in {out}")


@challenge.command("score")
def challenge_score(
    cases: Annotated[Path, typer.Argument(help="Folder of cases with commitments.json.")],
    answers: Annotated[Path, typer.Argument(help="Folder of answers.")],
    truth: Annotated[Path, typer.Option(help="Folder of the truth; refused if hashes differ.")],
    out: Annotated[Path, typer.Option(help="Folder for score.json, score.md and pictures.")],
    log: Annotated[
        Path | None, typer.Option(help="Markdown file to which the section is added.")
    ] = None,
    commit: Annotated[str, typer.Option(help="Commit that was judged, for the log.")] = "not given",
    json: Json = False,
) -> None:
    """Open the truth and count what was right."""
    from datetime import UTC, datetime

    from ffl.challenge import as_json, markdown
    from ffl.report.challenge import append_section, score_with_report

    about = {"date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", "commit": commit}
    result = score_with_report(cases, answers, truth, out, about)
    if log is not None:
        append_section(result, log, about)
    if json:
        print_json(as_json(result))
    else:
        print(markdown(result))
