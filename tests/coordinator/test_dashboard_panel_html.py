from html.parser import HTMLParser

import pytest

from robrain.coordinator.dashboard.panel_html import motes_html, robots_html, summary_html
from robrain.coordinator.dashboard.team_view import MoteView, TeamView
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.task import TaskState
from robrain.protocol.wire.inbox import Received
from robrain.protocol.wire.messages import (
    ArenaTruth,
    BatteryState,
    Halt,
    MoteReading,
    RobotState,
    TaskStatus,
)
from robrain.protocol.wire.topic import Topic
from robrain.protocol.wire.topics import ARENA_TRUTH, HALT, ROBOT_STATE

EVIL = "</b><script>alert(1)</script><img src=x onerror='alert(2)'>\" onclick=\"alert(3)"


class Page(HTMLParser):
    """Tags, attributes and the text of each data-testid."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.values: dict[str, str] = {}
        self._open: list[str | None] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "br":
            return
        self.attributes |= {name for name, _ in attrs}
        self._open.append(dict(attrs).get("data-testid"))

    def handle_endtag(self, tag: str) -> None:
        self._open.pop()

    def handle_data(self, data: str) -> None:
        for testid in filter(None, self._open):
            self.values[testid] = self.values.get(testid, "") + data


def tell(view: TeamView, topic: Topic, message: object, **names: str) -> None:
    view.apply(Received(topic, "", names, message), 0.0)


def test_robot_is_told_in_figures() -> None:
    view = TeamView()
    battery = BatteryState(voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=0.456, remaining_j=1.0)
    task = TaskStatus(id="t1", epoch=1, state=TaskState.RUNNING, why="the nearest border")
    state = RobotState(robot="r1", pose=Pose2D(1.25, -3.0, 0.0), battery=battery, behavior="explore", task=task)
    tell(view, ROBOT_STATE, state, robot="r1")
    values = Page(robots_html(view, 1.0)).values
    assert values["robot-r1-contact"].strip() == "up"
    assert values["robot-r1-battery"] == "46 %"
    assert values["robot-r1-place"] == "1.2, -3.0"
    assert values["robot-r1-behavior"] == "explore"
    assert values["robot-r1-task"] == "t1 running: the nearest border"
    assert Page(robots_html(view, 60.0)).values["robot-r1-contact"].strip() == "lost"


def test_figures_of_the_team_tell_what_is_known_and_no_more() -> None:
    view = TeamView()
    values = Page(summary_html(view)).values
    assert values["explored"] == "0 m²"
    assert (values["sim-time"], values["speed"], values["coordinator"]) == ("–", "–", "lost")
    assert "halt-state" not in values
    tell(view, ARENA_TRUTH, ArenaTruth(sim_time_s=75.0, robots=[], explored_fraction=0.42))
    view.coordinator_up = True
    values = Page(summary_html(view)).values
    assert (values["explored"], values["sim-time"], values["coordinator"]) == ("42.0 %", "1:15", "up")


def test_halt_is_told_with_how_many_obey() -> None:
    view = TeamView()
    tell(view, ROBOT_STATE, RobotState(robot="r1", halted=True), robot="r1")
    tell(view, ROBOT_STATE, RobotState(robot="r2"), robot="r2")
    tell(view, HALT, Halt(halted=True, by="dashboard", reason="smoke"))
    told = Page(summary_html(view)).values["halt-state"]
    assert told == "EMERGENCY HALT by dashboard: smoke.1 of 2 robots say that they are halted."


def test_lost_link_is_told_before_all_else() -> None:
    view = TeamView()
    view.connected = False
    assert "connection" in Page(summary_html(view)).values


def test_robots_are_sorted_as_people_count() -> None:
    view = TeamView()
    for name in ("r10", "r2", "r1"):
        tell(view, ROBOT_STATE, RobotState(robot=name), robot=name)
    assert Page(robots_html(view, 0.0)).values["robot-name"] == "r1r2r10"


@pytest.mark.parametrize("halted", [True, False])
def test_what_came_over_the_wire_never_becomes_markup(halted: bool) -> None:
    view = TeamView()
    task = TaskStatus(id=EVIL, epoch=1, state=TaskState.RUNNING, why=EVIL)
    tell(view, ROBOT_STATE, RobotState(robot=EVIL, behavior=EVIL, task=task, halted=halted), robot=EVIL)
    tell(view, HALT, Halt(halted=True, by=EVIL, reason=EVIL))
    reading = MoteReading(mote=EVIL, place=None, quantity=EVIL, value=1.0, voltage_v=3.0, rssi_dbm=-1, via=EVIL)
    view.motes[EVIL] = MoteView(EVIL, readings={EVIL: reading})
    for html in (summary_html(view), robots_html(view, 0.0), motes_html(view)):
        page = Page(html)
        assert page.tags <= {"div", "span", "b", "br", "table", "tr", "th", "td"}
        assert page.attributes <= {"class", "style", "title", "colspan", "data-testid"}
    assert EVIL in Page(robots_html(view, 0.0)).values["robot-name"]
