"""Where a limit of the command is looked for."""

import numpy as np
import pytest

from ffl.effects import EFFECTS
from ffl.effects.motion import Motion


@pytest.mark.parametrize("below", [0.001, 0.003, 0.01])
def test_a_limit_just_below_a_command_that_is_held_is_looked_for(below):
    """All upper quantiles of the command are where it is held."""
    u = np.concatenate([np.linspace(0.0, 1.0, 200), np.full(40, 1.32), np.linspace(1.0, 0.0, 200)])
    zero = np.zeros_like(u)
    motion = Motion(
        x=zero, v=zero, a=zero, u=u, r=zero, t=np.arange(len(u)) * 1e-3, sample_time=1e-3
    )
    limits = [start["limit"] for start in EFFECTS["saturation"].grid(motion)]
    wanted = 1.32 * (1.0 - below)
    assert min(abs(limit / wanted - 1.0) for limit in limits) < 0.1 * below
    assert max(limits) <= 1.32
