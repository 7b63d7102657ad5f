import threading

import numpy as np
import pytest

from ffl.diagnose.contest.parallel import each


def test_keeps_the_order_and_shares_out_what_is_shared_out_within():
    def product(a: int) -> int:
        return sum(each(lambda b: a * b, range(a)))

    assert each(product, range(40)) == [a * (a * (a - 1) // 2) for a in range(40)]
    assert each(product, []) == []


def test_another_thread_takes_part():
    both = threading.Barrier(2, timeout=60.0)  # passed only where two are at work at once
    assert each(lambda _: both.wait() >= 0, range(2)) == [True, True]


@pytest.mark.parametrize("bad", [0, 7, 19])
def test_an_exception_comes_through_and_ends_the_work(bad):
    def work(k: int) -> int:
        if k == bad:
            raise ValueError(f"piece {k}")
        return k

    with pytest.raises(ValueError, match=f"piece {bad}"):
        each(work, range(20))
    assert each(work, range(20, 23)) == [20, 21, 22]


def test_numpys_error_state_holds_for_every_piece():
    with np.errstate(over="ignore"):
        assert each(lambda x: np.float64(x) * 1e300, [1e300] * 6) == [np.inf] * 6
