"""The command line: thin verbs that parse, call and print; everything heavy is imported late."""

from __future__ import annotations

import json as json_text
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ffl.errors import InputError, WorkError

# One thread in linear algebra: the sums then come out the same in every process, and processes
# (--jobs) are the better use of the cores. A user's own setting stands.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

app = typer.Typer(
    name="ffl",
    help="Feedforward learning, inverse identification and diagnosis for machines that repeat motion.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Out = Annotated[Path | None, typer.Option("--out", help="Folder or file to write.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress on stderr.")]
Map = Annotated[
    Path | None, typer.Option("--map", help="TOML that maps column names, units and signs.")
]


def _print_json(document: Any) -> None:
    print(json_text.dumps(document, indent=1, allow_nan=False))


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
        _print_json(outcome.results)
    else:
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
    """Run a folder's resolved campaign again and say whether every number comes out the same."""
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
        _print_json({"schema": 1, "file": str(file), "valid": True, "says": said})
    else:
        print(f"{file}: {said}")


@app.command()
def report(
    folders: Annotated[list[Path], typer.Argument(help="Folders of finished runs.")],
    out: Out = None,
) -> None:
    """One report from one or more finished runs."""
    from ffl.report.learning import print_summary, write_report

    target = out or (folders[0] / "report.html" if len(folders) == 1 else Path("comparison.html"))
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
    json: Json = False,
) -> None:
    """One learning step on a real machine's recording: next feedforward and new state."""
    from ffl.report.step import step_with_report

    answer = step_with_report(model, basis, trial, out, map, state)
    if json:
        _print_json(answer)
        return
    from ffl.report.terminal import print_table

    rows = [[p["name"], p["value"], p["std_error"]] for p in answer["parameters"]]
    print_table(["parameter", "value", "std error"], rows)
    for name, entry in answer.get("documented", {}).items():
        off = 100 * entry["relative"]
        print(
            f"{name}: documented {entry['documented']:g}, learned {entry['learned']:.4g} ({off:+.1f} %)"
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
        _print_json(facts)
        return
    from ffl.report.terminal import print_table

    print_table(["what", "value"], [[k, v] for k, v in facts.items()])


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


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(help="printer2018, kernel2018 or bayes2025.")],
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
        _print_json(answer)
        return
    from ffl.report.terminal import print_table

    columns = ("key", "what", "paper", "ours", "unit", "std_error", "n")
    print_table(columns, [[row.get(name) for name in columns] for row in answer["rows"]])


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
    basis: Annotated[Path | None, typer.Option(help="TOML with `basis`, for instrumental.")] = None,
    n_ac: Annotated[int, typer.Option(help="Taps that look ahead.")] = 50,
    n_c: Annotated[int, typer.Option(help="Taps that look back.")] = 50,
    order: Annotated[
        list[int] | None, typer.Option(help="Order to try, may be repeated; for linear.")
    ] = None,
    out: Out = None,
    json: Json = False,
) -> None:
    """Identify an inverse system, or a forward linear model as a plant file, from recordings."""
    from ffl.report.identify import identify_with_report
    from ffl.report.terminal import print_table

    orders = order or range(1, 9)
    answer = identify_with_report(method, data, map, model, basis, n_ac, n_c, list(orders), out)
    if json:
        _print_json(answer)
        return
    for name, value in answer.items():
        if isinstance(value, list) and value and isinstance(value[0], dict):
            print(f"\n{name}")
            print_table(list(value[0]), [[row.get(k) for k in value[0]] for row in value])
        elif not isinstance(value, (list, dict)):
            print(f"{name}: {value:.6g}" if isinstance(value, float) else f"{name}: {value}")


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

    if out is not None and out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; give a folder for --out")
    here = Path()
    found = [find_recording(str(path), here) for path in recordings]
    judging = [find_recording(str(path), here) for path in validate or ()]
    quiet = quiet or not sys.stderr.isatty()
    answer = diagnose_with_report(model, found, judging, map, out, quiet)
    if json:
        _print_json(answer)
    else:
        print_answer(answer)


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
        _print_json(document)
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
        _print_json(as_json(result))
    else:
        print(markdown(result))


def _fail(message: str, code: int) -> int:
    print(" ".join(f"ffl: {message}".split()), file=sys.stderr)
    return code


def execute(args: list[str]) -> int:
    """Runs one command line; returns its exit code: 0 done, 1 not completed, 2 bad input."""
    import warnings

    warnings.simplefilter("ignore")  # stderr is for the one line that the user can act on
    try:
        code = app(args=args or ["--help"], prog_name="ffl", standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except InputError as error:
        return _fail(str(error), 2)
    except WorkError as error:
        return _fail(str(error), 1)
    except KeyboardInterrupt:
        return _fail("interrupted; what is complete stays on disk", 130)
    except BrokenPipeError:  # the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except SystemExit as error:  # the parser's own way out when the reader of stdout has gone
        return 0 if isinstance(error.__context__, BrokenPipeError) else int(error.code or 0)
    except OSError as error:
        bad = isinstance(
            error, (PermissionError, FileNotFoundError, IsADirectoryError, NotADirectoryError)
        )
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", 2 if bad else 1)
    except Exception as error:
        if hasattr(error, "format_message"):  # a usage error of the parser
            context = getattr(error, "ctx", None)
            command = context.command_path if context is not None else "ffl"
            return _fail(f"{error.format_message().rstrip('.')}. See '{command} --help'.", 2)
        if os.environ.get("FFL_TRACEBACK"):
            raise
        return _fail(
            f"internal error, {type(error).__name__}: {error} (FFL_TRACEBACK=1 shows where)", 1
        )


def main() -> None:
    sys.exit(execute(sys.argv[1:]))


if __name__ == "__main__":
    main()
