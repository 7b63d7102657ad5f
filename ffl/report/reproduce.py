"""`ffl reproduce`: a paper's tables and figures beside ours; one line in `PAPERS` per paper."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from ffl import __version__
from ffl.errors import InputError
from ffl.report.terminal import progress
from ffl.systems.atomic import require_own, write_text
from ffl.systems.plant_file import suggest

# paper -> (module whose `reproduce(fast=, jobs=, progress=)` measures and returns a result with `rows`,
#           module whose `page(result)` shows it)
PAPERS = {
    "printer2018": ("ffl.campaign.printer2018", "ffl.report.printer2018"),
    "kernel2018": ("ffl.identify.kernel2018", "ffl.report.kernel2018"),
    "bayes2025": ("ffl.identify.bayes", "ffl.report.bayes2025"),
    "papers_gap": ("ffl.campaign.papers_gap", "ffl.report.papers_gap"),
}


def reproduce_paper(
    paper: str, fast: bool = False, out: Path | None = None, jobs: int = 1, quiet: bool = False
) -> dict[str, Any]:
    """Measures, writes DIR/report.html and DIR/answer.json where `out` is given, returns the rows.

    `fast` uses fewer realisations; `n` of each row says how many.
    """
    if paper not in PAPERS:
        raise InputError(f"reproduce '{paper}': {suggest(paper, list(PAPERS))}")
    if jobs < 1:
        raise InputError(f"jobs = {jobs} must be at least 1")
    if out is not None:
        require_own(out, "paper")
    measure, show = PAPERS[paper]
    with progress(f"{paper}{' (fast)' if fast else ''}", 1.0, quiet) as advance:
        result = import_module(measure).reproduce(fast=fast, jobs=jobs, progress=advance)
    answer: dict[str, Any] = {"schema": 1, "paper": paper}
    if fast:
        answer["fast"] = True
    answer["rows"] = [row if isinstance(row, dict) else row.as_dict() for row in result.rows]
    if out is not None:
        import json

        page = import_module(show).page(result)
        page.footer = page.footer or f"Written by ffl {__version__}."
        write_text(out / "answer.json", json.dumps(answer, indent=1, allow_nan=False) + "\n")
        page.write(out / "report.html")
    return answer
