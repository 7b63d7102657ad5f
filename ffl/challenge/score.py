"""`ffl challenge score`: opens the commitments and judges every answer."""

from __future__ import annotations

import json
from pathlib import Path

from ffl.challenge.judge import judge
from ffl.challenge.scorecard import markdown
from ffl.challenge.seal import open_truths
from ffl.challenge.solve import read_answers
from ffl.challenge.tally import Score, as_json, tally


def score(
    cases_dir: Path | str, answers_dir: Path | str, truth_dir: Path | str, out: Path | str
) -> Score:
    """Open the truths (refused where a hash differs), judge every answer, write score.json and .md.

    A case without an answer counts as failed.
    """
    truths, document = open_truths(Path(cases_dir), Path(truth_dir))
    answers = read_answers(answers_dir)
    rows = [judge(truth, answers.get(name)) for name, truth in sorted(truths.items())]
    result = tally(rows, document["root"], document["seed"], document["fraction"])
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "score.json").write_text(json.dumps(as_json(result), indent=1, sort_keys=True) + "\n")
    (folder / "score.md").write_text(markdown(result))
    return result
