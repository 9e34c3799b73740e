from __future__ import annotations

from boxlift.stage_times import StageTimes


def test_stages_stand_in_the_order_they_ran() -> None:
    times = StageTimes()
    for name in ("ground", "fit"):
        with times.stage(name):
            pass
    assert list(times.seconds) == ["ground", "fit"]
    assert min(times.seconds.values()) >= 0
