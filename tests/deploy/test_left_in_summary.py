"""What a run's summary says of what exploration has left."""

import pytest

from robrain.deploy.processes.run_display import print_exploration_left
from robrain.protocol.messages.maps.left_messages import ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.model.geometry import Point2D


def region(kind: LeftKind, area_m2: float, gap_m: float | None = None) -> RegionLeft:
    place = Point2D(1.0, 2.0)
    needed_m = None if gap_m is None else 0.44
    return RegionLeft(kind=kind, place=place, area_m2=area_m2, low=place, high=place, gap_m=gap_m, needed_m=needed_m)


def test_places_that_robots_can_still_reach_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_exploration_left(ExplorationLeft(regions=[region(LeftKind.UNSEEN, 3.0), region(LeftKind.UNSEEN, 1.5)]))
    said = capsys.readouterr().out
    places = "not seen yet: 2 places that robots can reach, at most 4.5 m² together with the inside of obstacles"
    assert said == f"{places}; the largest is near (1.0, 2.0)\n"


def test_what_robots_cannot_see_has_a_row_each(capsys: pytest.CaptureFixture[str]) -> None:
    unseen, narrow = region(LeftKind.UNSEEN, 3.0), region(LeftKind.TOO_NARROW, 2.0, 0.3)
    print_exploration_left(ExplorationLeft(regions=[unseen, narrow, region(LeftKind.UNREACHABLE, 1.0)]))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("not seen yet: 1 place that robots can reach, at most 3.0 m²")
    assert [line.split()[0] for line in lines[1:]] == ["left", "kind", "too_narrow", "unreachable"]


def test_nothing_is_said_of_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    print_exploration_left(ExplorationLeft(regions=[]))
    assert capsys.readouterr().out == ""
