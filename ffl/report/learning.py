"""The verbs of learning campaigns: run with a report, report, rerun."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffl import __version__
from ffl.campaign import Campaign, Outcome, load_campaign, run_campaign
from ffl.campaign.differences import signal_differences, table_differences
from ffl.campaign.store import read_results, require_runs
from ffl.errors import InputError
from ffl.report.finished import read_folders
from ffl.report.terminal import print_table, progress

NAMED = 3  # differences that are named


def run_with_report(
    campaign: Campaign, out: Path | None, jobs: int = 1, resume: bool = False, quiet: bool = False
) -> Outcome:
    """Runs the campaign into `out` (default runs/NAME) and writes report.html beside the data."""
    folder = out if out is not None else Path("runs") / campaign.name
    outcome = _run(campaign, folder, jobs, resume, quiet)
    if any(run["error_norm"] for run in outcome.results["runs"]):
        write_report([folder], folder / "report.html")
    return outcome


def _run(campaign: Campaign, folder: Path, jobs: int, resume: bool, quiet: bool) -> Outcome:
    done: dict[str, int] = {}
    total = len(campaign.runs) * campaign.trials
    with progress(campaign.name, total, quiet) as advance:

        def tell(run: str, trial: int, norm: float) -> None:
            done[run] = trial
            advance(sum(done.values()), f"{run}, trial {trial}: ||e|| = {norm:.3g}")

        return run_campaign(campaign, folder, jobs, resume, tell)


def write_report(folders: Sequence[Path], target: Path) -> None:
    """One page from the folders' runs."""
    from ffl.report.learning_page import learning_page

    page = learning_page(read_folders(folders))
    results = read_results(folders[0])
    packages = ", ".join(f"{name} {text}" for name, text in results["versions"].items())
    page.footer = f"Written by ffl {__version__} from {len(folders)} folder(s); {packages}."
    page.write(target)


def own_report(content: bytes) -> bool:
    """Whether a page is one of `write_report`, by its footer."""
    return bool(re.search(rb"<footer>Written by ffl [^<]* from \d+ folder\(s\);", content))


def print_summary(folders: Sequence[Path]) -> None:
    """The runs as a table on stdout."""
    rows = []
    for run in read_folders(folders):
        norms = run.error_norm
        rows.append([run.label, run.entry["status"], run.entry["parameters"], len(norms),
                     norms[0], norms[-1], norms[-1] / norms[0]])  # fmt: skip
    header = ["run", "status", "parameters", "trials", "||e_1||", "||e_last||", "last/first"]
    print_table(header, rows)


def rerun_folder(folder: Path, out: Path | None, jobs: int, quiet: bool) -> bool:
    """Runs the folder's resolved campaign again; True where every number of results.json (wall times
    apart) and every signal on disk is the same to the bit."""
    before = read_results(folder)
    campaign = load_campaign(folder / "campaign.toml")
    require_runs(folder, before, [run.name for run in campaign.runs])
    for run in before["runs"]:
        if run["status"] == "running":
            raise InputError(
                f"{folder}: run '{run['name']}' has {len(run['error_norm'])} of {campaign.trials} trials; "
                f"finish it first: ffl run {folder / 'campaign.toml'} --out {folder} --resume"
            )
    if out is not None:
        return _compared(before, folder, run_with_report(campaign, out, jobs, quiet=quiet))
    with tempfile.TemporaryDirectory() as scratch:
        again = _run(campaign, Path(scratch) / "again", jobs, False, quiet)
        return _compared(before, folder, again)


def _compared(before: dict[str, Any], folder: Path, again: Outcome) -> bool:
    """Prints run by run what came out the same; True where all did."""
    rows, same = [], True
    done = {run["name"]: run for run in again.results["runs"]}
    for old in before["runs"]:
        name, new = old["name"], done[old["name"]]
        found, file = table_differences(old, new), folder / f"{name}.h5"
        if file.exists():
            signals = signal_differences(file, again.folder / file.name)
            found += [f"signal {signal}" for signal in signals]
        same &= not found
        alone = "" if file.exists() or not old["error_norm"] else f" ({file.name} is not there)"
        difference = _difference(old["error_norm"], new["error_norm"])
        rows.append([name, _told(found) + alone, difference])
    beside = table_differences(_campaign(before), _campaign(again.results))
    if beside:
        rows.append(["all", _told(beside), ""])
    print_table(["run", "numbers", "largest relative difference of ||e||"], rows)
    return same and not beside


def _campaign(results: dict[str, Any]) -> dict[str, Any]:
    """What results.json holds of the campaign as a whole; versions may differ."""
    return {key: value for key, value in results.items() if key not in ("runs", "versions")}


def _told(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"differs: {', '.join(names[:NAMED])}{more}" if names else "same"


def _difference(old: list[float], new: list[float]) -> float:
    n = min(len(old), len(new))
    a, b = np.array(old[:n]), np.array(new[:n])
    return float(np.max(np.abs(a - b) / np.abs(a), initial=0.0))
