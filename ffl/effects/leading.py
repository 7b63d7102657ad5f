"""Which effects on the command come before all others."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from ffl.effects.base import Effect, Parameters


def leading(effects: Iterable[tuple[Effect, Parameters]]) -> int:
    """How many of `effects`, in their order, bend the command before any other acts on it, but for what
    comes first wherever it is named: what is late is late alike before a limit and behind it."""
    acting = (e for e, values in effects if e.port == "command" and e.order(values) >= 0)
    return sum(1 for _ in itertools.takewhile(lambda effect: effect.bends, acting))
