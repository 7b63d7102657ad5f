"""How much a search has simulated: where nothing of the catalogue fits, it would go on and on."""

from __future__ import annotations

from dataclasses import dataclass, field
from threading import Lock

# Runs of all recordings, fitted or judging, from which no further round begins (usual: 1,000 to 15,000).
MOST = 20_000
# The same in sub-steps of all samples: what a core takes in some minutes (usual: 2 to 70 million).
MOST_STEPS = 200_000_000


@dataclass(eq=False)
class Work:
    """Runs that scenes sharing it have made, whoever made them in whatever order."""

    runs: int = 0
    steps: int = 0
    _lock: Lock = field(default_factory=Lock, repr=False)

    def add(self, steps: int) -> None:
        """One run of `steps` sub-steps."""
        with self._lock:
            self.runs += 1
            self.steps += steps

    @property
    def done(self) -> bool:
        """Asked between rounds, when all that was begun has ended: the same for any number of workers."""
        return self.runs >= MOST or self.steps >= MOST_STEPS
