"""What exploration has left, as the page shows it."""

import msgspec

from robrain.dashboard.html.team_html import left_html
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.maps.left_messages import ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.messages.team.arena_messages import ArenaClock
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.table.topics import ARENA_CLOCK, COORDINATOR_LEFT
from robrain.recording.drawing.drawn_map import FAR_M
from tests.dashboard.test_panel_html import Page

REGION = RegionLeft(
    kind=LeftKind.TOO_NARROW, place=Point2D(9.1, 2.2), area_m2=5.0, low=Point2D(4.1, 1.4), high=Point2D(9.9, 3.1),
    gap_m=0.387, needed_m=0.44, gap_at=Point2D(3.9, 2.2),
)  # fmt: skip


def told(view: ShownTeam, left: ExplorationLeft) -> ShownTeam:
    view.apply(Received(COORDINATOR_LEFT, COORDINATOR_LEFT.key("default"), {}, left), 0.0)
    return view


def test_regions_are_listed_with_kind_place_area_and_reason() -> None:
    html = left_html(told(ShownTeam(), ExplorationLeft(regions=[REGION], more=2, more_m2=1.5)))
    values = Page(html).values
    assert (values["left-1-kind"], values["left-1-place"], values["left-1-area"]) == (
        "too narrow",
        "9.1, 2.2",
        "5.0 m²",
    )
    assert values["left-1-why"] == "the gap is 0.39 m wide (measured), robots need 0.44 m"
    assert values["left-more"] == "and 2 more, 1.5 m²"


def test_before_exploration_has_ended_nothing_is_shown_and_then_that_nothing_is_left() -> None:
    view = ShownTeam()
    assert left_html(view) == ""
    assert "Nothing is left" in left_html(told(view, ExplorationLeft()))


def test_another_run_and_impossible_places_leave_no_regions() -> None:
    view = told(ShownTeam(), ExplorationLeft(regions=[REGION]))
    far = msgspec.structs.replace(REGION, place=Point2D(2 * FAR_M, 0.0))
    told(view, ExplorationLeft(regions=[far]))
    assert view.rejected == 1
    assert view.left == ExplorationLeft(regions=[REGION])
    for sim_time_s in (100.0, 1.0):
        view.apply(Received(ARENA_CLOCK, ARENA_CLOCK.key("default"), {}, ArenaClock(sim_time_s=sim_time_s)), 0.0)
    assert view.left is None
