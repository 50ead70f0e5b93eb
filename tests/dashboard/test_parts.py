"""Parts of the page: stock ones, those of other distributions, and topics that only a part reads."""

import pytest

from robrain.dashboard.layers.layer import Layer, OwnLayer
from robrain.dashboard.panels.page import Panel, Tab
from robrain.dashboard.state import parts
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.team.arena_messages import ARENA_OUTSIDE
from robrain.protocol.messages.team.zone_messages import COORDINATOR_ZONES
from robrain.protocol.registry import Registry


class GasTab(Tab):
    """A tab of another distribution."""

    title = "Gas"
    topics = (ARENA_OUTSIDE,)


@pytest.fixture
def with_gas(monkeypatch: pytest.MonkeyPatch) -> None:
    stock = parts.STOCK | {"broken": "robrain.dashboard.nowhere:Nothing"}
    registry: Registry[type] = Registry("dashboard part", "robrain.dashboard_parts", stock)
    registry.register("gas", GasTab)
    monkeypatch.setattr(parts, "DASHBOARD_PARTS", registry)
    monkeypatch.setattr(parts, "STOCK", stock)


def test_every_stock_part_is_a_tab_a_panel_or_a_layer_and_shown_in_the_order_of_the_registry() -> None:
    kinds = [parts.parts_of(kind) for kind in (Layer, Tab, Panel)]
    assert sum(map(len, kinds)) == len(parts.STOCK)
    assert [tab.title for tab in parts.parts_of(Tab)] == ["Team", "Robot", "Tasks", "View"]
    assert [layer.label for layer in parts.parts_of(OwnLayer)] == ["Lidar"]
    assert [layer.name for layer in parts.parts_of(Layer)][:3] == ["floor", "walls", "robots"]


def test_parts_of_others_come_last_and_one_that_cannot_be_imported_is_skipped(
    with_gas: None, caplog: pytest.LogCaptureFixture
) -> None:
    assert [tab.title for tab in parts.parts_of(Tab)] == ["Team", "Robot", "Tasks", "View", "Gas"]
    assert "dashboard part broken" in caplog.text
    assert parts.topics_of_parts() == [COORDINATOR_ZONES, ARENA_OUTSIDE]


def test_last_message_of_a_topic_that_only_a_part_reads_is_kept() -> None:
    view = ShownTeam()
    assert ARENA_OUTSIDE not in view.topics
    for message in ("one", "two"):
        view.apply(Received(ARENA_OUTSIDE, "key", {}, message), 0.0)
    assert view.others == {"key": "two"}
