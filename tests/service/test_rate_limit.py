from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from boxlift_service.guards.rate_limit import RateLimits


@pytest.mark.parametrize("rate", [1, 3, 7, 60, 999, 100_000])
def test_a_minute_s_worth_at_once_and_then_evenly(rate: int) -> None:
    limits, now = RateLimits(), 1e6
    assert [limits.wait_s("studio", rate, now) for _ in range(rate)] == [0.0] * rate
    wait_s = limits.wait_s("studio", rate, now)
    assert wait_s == pytest.approx(60 / rate, rel=1e-2)
    assert limits.wait_s("studio", rate, now + wait_s) == 0.0
    assert limits.wait_s("studio", rate, now + wait_s) > 0.0


def test_a_refused_request_costs_nothing_and_an_hour_saves_nothing_up() -> None:
    limits = RateLimits()
    assert [limits.wait_s("studio", 2, 0.0) > 0 for _ in range(9)] == [False, False] + [True] * 7
    assert limits.wait_s("studio", 2, 30.0) == 0.0
    assert [limits.wait_s("studio", 2, 3600.0) > 0 for _ in range(4)] == [False, False, True, True]


def test_half_a_token_is_none() -> None:
    limits = RateLimits()
    assert limits.wait_s("studio", 1, 0.0) == 0.0
    assert limits.wait_s("studio", 1, 30.0) == pytest.approx(30.0)
    assert limits.wait_s("studio", 1, 60.0) == 0.0


def test_keys_do_not_share() -> None:
    limits = RateLimits()
    assert limits.wait_s("studio", 1, 0.0) == 0.0
    assert limits.wait_s("studio", 1, 0.0) > 0.0
    assert limits.wait_s("batch", 1, 0.0) == 0.0
    assert [limits.wait_s("free", 0, 0.0) for _ in range(1000)] == [0.0] * 1000


def test_full_buckets_are_forgotten() -> None:
    limits = RateLimits()
    for hour in range(50):
        for key in range(20):
            limits.wait_s(f"key-{hour}-{key}", 5, hour * 3600.0)
    assert len(limits) == 20


@given(
    rate=st.integers(1, 600),
    gaps=st.lists(st.floats(0, 90, allow_nan=False), min_size=1, max_size=200),
    patient=st.booleans(),
)
def test_no_stretch_of_time_sees_more_than_its_share(rate: int, gaps: list[float], patient: bool) -> None:
    limits, now, admitted = RateLimits(), 1e5, []
    for gap in gaps:
        now += gap
        wait_s = limits.wait_s("studio", rate, now)
        assert 0 <= wait_s <= 60
        if wait_s and patient:
            now += wait_s
            assert limits.wait_s("studio", rate, now) == 0.0
            wait_s = 0.0
        if not wait_s:
            admitted.append(now)
    for first, start in enumerate(admitted):
        for last in range(first, len(admitted)):
            assert last - first + 1 <= rate + (admitted[last] - start) * rate / 60 + 1
