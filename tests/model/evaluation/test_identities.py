"""Identity switches, by hand."""

from __future__ import annotations

from boxlift.evaluation.identities import Tracked, judge_identities
from boxlift.formats.kitti_label import KittiObject


def at(track: int, x_px: float) -> Tracked:
    box_px = (x_px, 10.0, x_px + 20, 30.0)
    return track, KittiObject("Car", 0.0, 0, 0.0, box_px, (1.5, 1.7, 4.0), (0.0, 1.6, 20.0), 0.0, 0.9)


def test_a_track_that_stays_has_no_switch() -> None:
    frames = [([at(7, 0), at(8, 100)], [at(1, 101), at(2, 1)]) for _ in range(4)]
    found = judge_identities(frames)
    assert (found.truths, found.associated, found.switches, found.tracks_found) == (2, 8, 0, 2)


def test_every_change_of_id_is_one_switch_also_over_a_gap() -> None:
    told = [[at(1, 0)], [at(1, 0)], [], [at(2, 0)], [at(1, 0)]]
    found = judge_identities(([at(7, 0)], each) for each in told)
    assert (found.associated, found.switches, found.tracks_found) == (4, 2, 2)


def test_what_does_not_overlap_is_nobodys() -> None:
    found = judge_identities([([at(7, 0)], [at(1, 60)]), ([], [at(1, 0)]), ([at(7, 0)], [])])
    assert (found.truths, found.associated, found.switches) == (1, 0, 0)


def test_two_objects_that_swap_ids_are_two_switches() -> None:
    first = ([at(7, 0), at(8, 100)], [at(1, 0), at(2, 100)])
    second = ([at(7, 0), at(8, 100)], [at(2, 0), at(1, 100)])
    assert judge_identities([first, second]).switches == 2
