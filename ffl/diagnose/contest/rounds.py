"""What the contest went through, round by round, and where it ended."""

from __future__ import annotations

from dataclasses import dataclass

from ffl.diagnose.contest.earning import UNTOLD
from ffl.diagnose.contest.judging import Judged, credible, judge
from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.screen.candidate import Candidate

FURTHER = 4  # times 8 rounds that the best of a round are fitted on


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the contest: what stood, who challenged it, what they reached. `turned_down`: who was
    accepted, and did not hold up once all was refitted."""

    before: Judged
    screened: tuple[Candidate, ...]
    rivals: tuple[Judged, ...]
    accepted: Judged | None
    turned_down: Judged | None = None

    @property
    def refused(self) -> Judged | None:
        """Who was turned down; where nobody came in, the likeliest of those who might have, or who explains
        far more of fitted and held-out recordings with numbers that are of no such physics: company may
        mend them. (A friction without the drag beside it: 72 % more damping stood for that, and its
        level at speed was 0.)"""
        if self.turned_down is not None or self.accepted is not None:
            return self.turned_down
        if not self.rivals:
            return None
        able = next((rival for rival in self.rivals if credible(rival)), None)
        first, others = self.rivals[0], [one for one in (self.before, able) if one is not None]
        far = all(
            min(first.fitted - one.fitted, first.held_out - one.held_out) > UNTOLD for one in others
        )
        return first if far else able

    @property
    def joined(self) -> tuple[str, ...]:
        """The effects that came in: one, two at once, or none."""
        if self.accepted is None:
            return ()
        return self.accepted.model.names[len(self.before.model.names) :]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What stands at the end, all rounds, the held-out recordings with their starts, and for each
    effect by name every hypothesis that was fitted in its place beside the others, its own included."""

    standing: Judged
    steps: list[Step]
    held: Scene | None
    contenders: dict[str, list[tuple[str, Judged]]]

    @property
    def tried(self) -> list[Judged]:
        """Whoever was fitted to join in any round: first who came in, whether they stayed or not, then the
        others, the likeliest by the noise of their round first."""
        came = [one for step in self.steps for one in (step.accepted, step.turned_down) if one]
        rivals = [rival for step in self.steps for rival in step.rivals]
        return [*came, *sorted(rivals, key=lambda rival: -rival.score)]


def to_the_end(quiet: Scene, held: Scene | None, judged: Judged) -> Judged:
    """`judged` fitted on until it converges: where the model's own numbers had stood in for an effect they
    have far to go (a lag for which a mass five times too large had stood: 44 nats after 6 rounds, 92 in
    the end, hardly any on the way)."""
    for _ in range(FURTHER):
        model = judged.model.beyond()
        if judged.fit.status != "rounds" and model is judged.model:
            break
        judged = judge(quiet, held, model, 8, judged.fit)
    return judged
