"""The circle closed on machines drawn at random: the stall, the diagnosis, the drop.

    python benchmarks/missing_physics.py campaigns/printer_with_missing_physics.toml \\
        --machines 10 --out runs/missing_physics

Writes missing_physics.md (a row for every machine drawn) and missing_physics.png. `--given` gives the
effects' names and places instead of diagnosing them: the bound of what a diagnosis can bring.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from ffl.campaign import load_campaign
from ffl.campaign.missing_physics import Story, diagnosed, draw_effects, story
from ffl.report.missing_physics import write

PEAK, STROKE = 180.0, 0.3  # N, m


def told(story: Story, seconds: float) -> str:
    names = ", ".join(e.name for e in story.found)
    return (
        f"machine {story.seed}: {names}; stall {story.stall:.3f}, drop {100 * story.drop:.1f} %, "
        f"extrapolation {100 * story.extrapolation:.1f} %, machine over promise "
        f"{100 * story.promise_gap:+.0f} +- {100 * story.promise_doubt:.0f} %; {seconds:.0f} s CPU"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("campaign", type=Path)
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("runs/missing_physics"))
    parser.add_argument("--given", action="store_true")
    given = parser.parse_args()
    campaign = load_campaign(given.campaign)
    stories = []
    for seed in range(given.machines):
        start = time.process_time()
        effects = draw_effects(seed, PEAK, STROKE)
        stories.append(story(campaign, effects, seed, None if given.given else diagnosed))
        print(told(stories[-1], time.process_time() - start), flush=True)
        write(stories, given.out, "# Missing physics", "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
