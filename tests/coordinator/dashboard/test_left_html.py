"""What exploration has left, as the page shows it."""

from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import msgspec
import pytest

from robrain.coordinator.dashboard.html.left_html import ROWS, left_html
from robrain.coordinator.dashboard.layers.left_layer import LeftLayer, frame, left_label
from robrain.coordinator.dashboard.panels.team_tab import TeamTab
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.coordinator.drawing import palette
from robrain.coordinator.drawing.map_view import FAR_M
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.messages.maps.left_messages import ExplorationLeft, LeftKind, RegionLeft
from robrain.protocol.wire.messages.team.arena_messages import ArenaClock
from robrain.protocol.wire.topics import ARENA_CLOCK, COORDINATOR_LEFT
from tests.coordinator.dashboard.test_panel_html import Page

REGION = RegionLeft(
    kind=LeftKind.TOO_NARROW, place=Point2D(9.1, 2.2), area_m2=5.0, low=Point2D(4.1, 1.4), high=Point2D(9.9, 3.1),
    gap_m=0.387, needed_m=0.44, gap_at=Point2D(3.9, 2.2),
)  # fmt: skip


def told(view: TeamView, left: ExplorationLeft) -> TeamView:
    view.apply(Received(COORDINATOR_LEFT, COORDINATOR_LEFT.key("default"), {}, left), 0.0)
    return view


def test_regions_are_listed_with_kind_place_area_and_reason() -> None:
    html = left_html(told(TeamView(), ExplorationLeft(regions=[REGION], more=2, more_m2=1.5)))
    values = Page(html).values
    assert (values["left-1-kind"], values["left-1-place"], values["left-1-area"]) == (
        "too narrow",
        "9.1, 2.2",
        "5.0 m²",
    )
    assert values["left-1-why"] == "the gap is 0.39 m wide (measured), robots need 0.44 m"
    assert values["left-more"] == "and 2 more, 1.5 m²"


def test_of_many_regions_the_first_are_listed_and_the_others_summed() -> None:
    html = left_html(told(TeamView(), ExplorationLeft(regions=[REGION] * (ROWS + 3), more=1, more_m2=0.5)))
    assert Page(html).values["left-more"] == "and 4 more, 15.5 m²"


def test_before_exploration_has_ended_nothing_is_shown_and_then_that_nothing_is_left() -> None:
    view = TeamView()
    assert left_html(view) == ""
    assert "Nothing is left" in left_html(told(view, ExplorationLeft()))


def test_another_run_and_impossible_places_leave_no_regions() -> None:
    view = told(TeamView(), ExplorationLeft(regions=[REGION]))
    far = msgspec.structs.replace(REGION, place=Point2D(2 * FAR_M, 0.0))
    told(view, ExplorationLeft(regions=[far]))
    assert view.rejected == 1
    assert view.left == ExplorationLeft(regions=[REGION])
    for sim_time_s in (100.0, 1.0):
        view.apply(Received(ARENA_CLOCK, ARENA_CLOCK.key("default"), {}, ArenaClock(sim_time_s=sim_time_s)), 0.0)
    assert view.left is None


def test_the_tab_of_the_team_has_a_folder_for_it_that_is_hidden_until_then() -> None:
    gui, folders, texts = MagicMock(), {}, []

    def add_folder(name: str, **options: Any) -> MagicMock:
        folders[name] = MagicMock(visible=options.get("visible", True))
        return folders[name]

    def add_html(content: str) -> SimpleNamespace:
        texts.append(SimpleNamespace(content=content))
        return texts[-1]

    gui.add_folder, gui.add_html = add_folder, add_html
    view = TeamView()
    page: Any = SimpleNamespace(client=SimpleNamespace(gui=gui), context=SimpleNamespace(view=view), selected=None)
    tab = TeamTab(page)
    tab.draw(0.0)
    assert not folders["Left to explore"].visible
    told(view, ExplorationLeft(regions=[REGION]))
    tab.draw(1.0)
    assert folders["Left to explore"].visible
    assert left_html(view) in [one.content for one in texts]


def test_the_map_has_a_frame_around_each_region_and_a_mark_at_its_place() -> None:
    vertices, _ = frame(REGION)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert (low[0], low[1], high[0], high[1]) == pytest.approx((4.07, 1.37, 9.93, 3.13))
    unseen = msgspec.structs.replace(REGION, kind=LeftKind.UNSEEN)
    view = told(TeamView(), ExplorationLeft(regions=[REGION, unseen]))
    layer = LeftLayer(MagicMock())
    assert set(layer._meshes(view, 0.0)) == {palette.BAD, palette.WARNING}
    assert layer._meshes(TeamView(), 0.0) == {}
    assert left_label(REGION) == "too narrow, 5.0 m2"
