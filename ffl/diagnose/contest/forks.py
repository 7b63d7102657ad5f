"""Who comes second by a little, where something is left that nobody may explain: another way to go on."""

from __future__ import annotations

from ffl.diagnose.contest.judging import Judged, promise
from ffl.diagnose.contest.rounds import Outcome
from ffl.diagnose.contest.settle import CREEPING, DRY, KEEP

NEAR = 0.3  # of what the best refused would bring: a rival behind by less may be the better start
FORKS = 2  # most of these that are followed


def forks(outcome: Outcome) -> list[tuple[str, Judged]]:
    """(effect, hypothesis with another in its place), best first, that come near what stands, leave
    something else than it, and by less than what the best of those that found no leave would bring,
    its numbers not charged: it tells how much is left."""
    refused = []
    for step in reversed(outcome.steps):
        if step.accepted is not None:
            break
        refused += [
            rival.fitted + rival.held_out - step.before.fitted - step.before.held_out
            for rival in step.rivals
        ]
    left = max(refused, default=0.0)
    if left < KEEP:
        return []
    out = []
    for name, others in outcome.contenders.items():
        own = others[0][1]
        for rival, other in others[1:]:
            gap = own.score - other.score
            if rival == name or {rival, name} <= DRY - CREEPING or gap > NEAR * left:
                continue  # forms of one friction differ by too little to be another way
            if promise(other.fit.white, own.fit.white) > gap + KEEP:
                out.append((gap, name, other))
    nearest: dict[tuple[str, ...], tuple[str, Judged]] = {}
    for _, name, other in sorted(out, key=lambda f: f[0]):
        nearest.setdefault(other.model.names, (name, other))
    return list(nearest.values())[:FORKS]
