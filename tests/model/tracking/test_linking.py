"""Boxes of one object get one track, and boxes of two get two."""

from __future__ import annotations

import numpy as np

from boxlift.tracking.linking import Track, link
from boxlift.tracking.sightings import Sighting

CAR, PERSON = (4.2, 1.8, 1.5), (0.8, 0.6, 1.75)


def sighting(
    sweep: int,
    x: float,
    y: float,
    *,
    lwh_m: tuple[float, float, float] = CAR,
    score: float = 0.9,
    category: str = "Car",
    item: int = 0,
) -> Sighting:
    center = np.array([x, y, lwh_m[2] / 2])
    return Sighting(sweep, ((0, item),), category, score, center, 0.0, lwh_m, float(np.hypot(x, y)))


def linked(sweeps: list[list[Sighting]], period_s: float = 0.1) -> list[Track]:
    return link([(number * period_s, each) for number, each in enumerate(sweeps)])


def sweeps_of(track: Track) -> list[int]:
    return [each.sweep for each in track.sightings]


def test_cars_parked_side_by_side_keep_apart() -> None:
    rng = np.random.default_rng(0)
    sweeps = [
        [sighting(n, 20 + rng.normal(0, 0.2), 2.4 * k + rng.normal(0, 0.2), item=k) for k in range(6)]
        for n in range(30)
    ]
    tracks = linked(sweeps)
    assert len(tracks) == 6
    for track in tracks:
        assert len({each.members for each in track.sightings}) == 1
        assert sweeps_of(track) == list(range(30))


def test_a_car_on_its_way_is_followed_through_a_gap_and_past_another() -> None:
    sweeps = []
    for n in range(40):
        seen = [sighting(n, 30.0, 3.0, item=1)]
        if not 15 <= n < 22:
            seen.append(sighting(n, 10 + 1.2 * n, 0.0))
        sweeps.append(seen)
    tracks = linked(sweeps)
    assert sorted(len(track.sightings) for track in tracks) == [33, 40]


def test_what_stands_is_found_again_after_seconds_and_what_moved_on_is_not() -> None:
    stands = [[sighting(n, 20, 0)] if n < 8 or n >= 60 else [] for n in range(70)]
    assert [len(track.sightings) for track in linked(stands)] == [18]
    moves = [[sighting(n, 1.0 * n, 0)] if n < 8 or n >= 60 else [] for n in range(70)]
    assert len(linked(moves)) == 2


def test_a_person_is_no_car_and_a_van_may_be_one() -> None:
    person = sighting(1, 10, 0, lwh_m=PERSON, category="Pedestrian")
    assert len(linked([[sighting(0, 10, 0)], [person]])) == 2
    (track,) = linked([[sighting(0, 10, 0)], [sighting(1, 10.1, 0, category="Van", score=0.4)]])
    assert track.category == "Car"


def test_phantoms_are_tracks_of_their_own() -> None:
    sweeps = [[sighting(n, 20, 0)] for n in range(10)]
    sweeps[4].append(sighting(4, 40, 9, score=0.1, item=1))
    assert sorted(len(track.sightings) for track in linked(sweeps)) == [1, 10]


def test_no_boxes_no_tracks() -> None:
    assert linked([]) == []
    assert linked([[], [], []]) == []


def test_the_order_of_boxes_within_a_sweep_changes_no_track() -> None:
    rng = np.random.default_rng(1)
    sweeps = [
        [sighting(n, 20 + 4 * k + rng.normal(0, 0.2), 3 * k + rng.normal(0, 0.2), item=k) for k in range(4)]
        for n in range(12)
    ]
    there = linked(sweeps)
    back = linked([each[::-1] for each in sweeps])
    members = [sorted((s.sweep, s.members) for s in track.sightings) for track in there]
    assert sorted(members) == sorted(sorted((s.sweep, s.members) for s in t.sightings) for t in back)
