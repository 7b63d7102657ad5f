"""`ffl challenge score`: opens the commitments and judges every answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ffl.challenge.judge import judge
from ffl.challenge.scorecard import markdown
from ffl.challenge.seal import open_truths
from ffl.challenge.solve import read_answers
from ffl.challenge.tally import Score, as_json, tally
from ffl.systems.atomic import require_folder, write_text


def score(
    cases_dir: Path | str,
    answers_dir: Path | str,
    truth_dir: Path | str,
    out: Path | str,
    about: Mapping[str, str] | None = None,
) -> Score:
    """Open the truths (refused where a hash differs), judge every answer, write score.json and .md.

    A case without an answer counts as failed. about: lines for the head of score.md (date, commit,
    command).
    """
    folder = Path(out)
    require_folder(folder)
    truths, document = open_truths(Path(cases_dir), Path(truth_dir))
    answers = read_answers(answers_dir)
    rows = [judge(truth, answers.get(name)) for name, truth in sorted(truths.items())]
    result = tally(rows, document["root"], document["seed"], document["fraction"])
    write_text(folder / "score.json", json.dumps(as_json(result), indent=1, sort_keys=True) + "\n")
    write_text(folder / "score.md", markdown(result, about))
    return result
