from html.parser import HTMLParser

import pytest

from robrain.dashboard.html.robot_html import events_html, plugin_card_html, plugins_html, result_html, robot_card_html
from robrain.dashboard.html.task_html import explanation_html, gantt_html, queue_html
from robrain.dashboard.html.team_html import log_html, motes_html, robots_html, strip_html, summary_html
from robrain.dashboard.panels.halt_control import acknowledgements_html
from robrain.dashboard.panels.picture_tab import scale_html
from robrain.dashboard.panels.replay_bar import marks_html
from robrain.dashboard.replay.replay_source import Mark
from robrain.dashboard.state.shown_robot import ShownMote
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots import plugin_messages, robot_messages
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, LogRecord, PluginEvent, PluginInfo
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.tasks.task_messages import RobotVerdict, TaskChange, TaskExplanation, TaskRecord
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth
from robrain.protocol.messages.team.service_messages import RobotLabel
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt, RobotSummary, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.dashboard.test_shown_team import tell
from tests.energy_models import energy_model

EVIL = "</b><script>alert(1)</script><img src=x onerror='alert(2)'>\" onclick=\"alert(3)"


TAGS = {"div", "span", "b", "i", "br", "p", "h4", "pre", "button", "table", "tr", "th", "td"}
TAGS |= {"svg", "text", "line", "rect", "title"}
ATTRIBUTES = {"class", "style", "title", "colspan", "tabindex", "role", "data-testid", "data-rb", "data-rb-beat"}
ATTRIBUTES |= {"viewbox", "width", "height", "x", "y", "x1", "x2", "y1", "y2", "rx", "text-anchor"}
ATTRIBUTES |= {"fill", "fill-opacity", "stroke", "stroke-width", "stroke-dasharray"}
"""None of these runs a program, whatever its value."""


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
        if tag in ("br", "line"):
            return
        self.attributes |= {name for name, _ in attrs}
        self._open.append(dict(attrs).get("data-testid"))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}

    def handle_endtag(self, tag: str) -> None:
        self._open.pop()

    def handle_data(self, data: str) -> None:
        for testid in filter(None, self._open):
            self.values[testid] = self.values.get(testid, "") + data


def test_robot_is_told_in_figures() -> None:
    view = ShownTeam()
    battery = BatteryState(voltage_v=24.0, current_a=1.0, temperature_c=30.0, soc=0.456, remaining_j=1.0)
    task = TaskStatus(id="t1", epoch=1, state=TaskState.RUNNING, why="the nearest border")
    energy = energy_model(8.0, usable_j=5000.0, usual_power_w=10.0)
    at = Pose2D(1.25, -3.0, 0.0)
    state = RobotState(robot="r1", pose=at, battery=battery, energy=energy, behavior="explore", task=task)
    tell(view, robot_messages.ROBOT_STATE, state, robot="r1")
    values = Page(robots_html(view, 1.0)).values
    assert values["robot-r1-contact"].strip() == "● up"
    assert values["robot-r1-battery"] == "46 % 8 min"
    assert Page(robot_card_html(view, view.robots["r1"], 1.0)).values["robot-r1-place"] == "1.2, -3.0"
    assert values["robot-r1-behavior"] == "explore"
    assert values["robot-r1-task"] == "t1 running: the nearest border"
    assert Page(robots_html(view, 60.0)).values["robot-r1-contact"].strip() == "✕ lost"


def test_figures_of_the_team_tell_what_is_known_and_no_more() -> None:
    view = ShownTeam()
    values = Page(summary_html(view, 0.0)).values
    assert values["explored"] == "0 m²"
    assert (values["sim-time"], values["speed"], values["coordinator"]) == ("–", "–", "lost")
    assert "halt-state" not in Page(strip_html(view, 0.0)).values
    tell(view, ARENA_TRUTH, ArenaTruth(sim_time_s=75.0, robots=[], explored_fraction=0.42))
    view.coordinator_up = True
    values = Page(summary_html(view, 0.0)).values
    assert (values["explored"], values["sim-time"], values["coordinator"]) == ("42.0 %", "1:15", "up")


def test_halt_is_told_with_how_many_obey() -> None:
    view = ShownTeam()
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot="r1", halted=True), robot="r1")
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot="r2"), robot="r2")
    tell(view, HALT, Halt(halted=True, by="dashboard", reason="smoke"))
    told = Page(strip_html(view, 0.0)).values["halt-state"]
    assert told == "EMERGENCY HALT by dashboard: smoke.1 of 2 robots report that they are halted."


TRACEBACK = """Traceback (most recent call last):
  File "/home/ada/my_plugins/greeter.py", line 12, in step
    self.seconds += one
NameError: name 'one' is not defined <b>"""


def test_error_of_a_plugin_is_shown_with_file_line_and_traceback_on_the_robots_page() -> None:
    plugin = PluginInfo(name="greeter", level="unit", state="faulted", why=TRACEBACK)
    card = Page(plugin_card_html(plugin))
    assert card.values["plugin-why"] == TRACEBACK
    view = ShownTeam()
    state = RobotState(robot="r1", faulted=[PluginFault(plugin="greeter", why=TRACEBACK)])
    tell(view, robot_messages.ROBOT_STATE, state, robot="r1")
    assert Page(robot_card_html(view, view.robots["r1"], 0.0)).values["plugin-why"] == TRACEBACK
    # Above the tabs there is room for its last line.
    alerts = Page(strip_html(view, 0.0)).values["alerts"]
    assert "greeter does not run: NameError: name 'one' is not defined <b>" in alerts
    assert "Traceback" not in alerts


@pytest.mark.parametrize("halted", [True, False])
def test_what_came_over_the_wire_never_becomes_markup(halted: bool) -> None:
    view = evil_view(halted)
    robot = view.robots[EVIL]
    why = TaskExplanation(
        record=TaskRecord(task=Task(id=EVIL, kind="visit", place=Point2D(0.0, 0.0)), state=TaskState.FAILED, why=EVIL),
        now=EVIL,
        robots=[RobotVerdict(robot=EVIL, refusal=EVIL)],
        changes=[TaskChange(number=1, stamp_ns=0, state=TaskState.FAILED, robot=EVIL, why=EVIL)],
    )
    plugin = PluginInfo(
        name=EVIL,
        level=EVIL,
        state=EVIL,
        why=EVIL,
        visibility=[EVIL],
        requires=[EVIL],
        holder=EVIL,
        distribution=EVIL,
        doc=EVIL,
        functions=[FunctionInfo(name=EVIL, signature=EVIL, doc=EVIL, parameters={}, returns={})],
    )
    pages = [
        strip_html(view, 0.0),
        summary_html(view, 0.0),
        robots_html(view, 0.0, EVIL),
        motes_html(view),
        log_html(view),
        robot_card_html(view, robot, 0.0),
        events_html(robot),
        plugins_html([plugin], EVIL, ""),
        plugins_html([], "", EVIL),
        plugin_card_html(plugin),
        result_html(EVIL, b'{"a": "' + b"<b>" + b'"}', ""),
        result_html(EVIL, EVIL.encode(), ""),
        result_html(EVIL, b"", EVIL),
        queue_html(view, is_live=True),
        gantt_html(view),
        explanation_html(why),
        acknowledgements_html(view, 1),
        scale_html(EVIL, 0.0, 1.0),
        marks_html([Mark(1.0, "fault", EVIL)], 10.0, 2.0, playing=True),
    ]
    for html in pages:
        page = Page(html)
        assert page.tags <= TAGS
        assert page.attributes <= ATTRIBUTES
    assert EVIL in Page(robots_html(view, 0.0)).values["robot-name"]


def evil_view(halted: bool) -> ShownTeam:
    """Every string that can come over the wire is an attack."""
    view = ShownTeam()
    status = TaskStatus(id=EVIL, epoch=1, state=TaskState.RUNNING, why=EVIL)
    state = RobotState(
        robot=EVIL,
        behavior=EVIL,
        task=status,
        halted=halted,
        not_halted=[EVIL],
        faulted=[PluginFault(plugin=EVIL, why=EVIL)],
        lost=EVIL,
        battery=BatteryState(
            voltage_v=1.0, current_a=1.0, temperature_c=1.0, soc=0.1, remaining_j=1.0, implausible=EVIL
        ),
    )
    tell(view, robot_messages.ROBOT_STATE, state, robot=EVIL)
    tell(view, HALT, Halt(halted=True, by=EVIL, reason=EVIL))
    tell(view, plugin_messages.ROBOT_LOG, LogRecord(robot=EVIL, level=EVIL, source=EVIL, text=EVIL), robot=EVIL)
    tell(
        view,
        plugin_messages.ROBOT_EVENT,
        PluginEvent(robot=EVIL, plugin=EVIL, event=EVIL, value=EVIL),
        robot=EVIL,
        plugin="p",
        event="e",
    )
    task = Task(id=EVIL, kind="visit", place=Point2D(1.0, 2.0))
    running = TaskEvent(task=task, state=TaskState.RUNNING, robot=EVIL, why=EVIL)
    tell(view, TASK_EVENT, running, task="t")
    other = Task(id=EVIL + "2", kind="visit", place=Point2D(1.0, 2.0))
    tell(view, TASK_EVENT, TaskEvent(task=other, state=TaskState.FAILED, robot=EVIL, why=EVIL), task="u")
    reading = MoteReading(mote=EVIL, place=None, quantity=EVIL, value=1.0, voltage_v=2.0, rssi_dbm=-1, via=EVIL)
    view.motes[EVIL] = ShownMote(EVIL, readings={EVIL: reading})
    return view


def test_a_renamed_robot_is_shown_by_both_names():
    view, label = ShownTeam(), RobotLabel("Picker", "ann")
    robots = [RobotSummary(name="r1", up=True, age_s=0.0, label=label)]
    tell(view, COORDINATOR_STATE, TeamState(robots=robots))
    assert Page(robots_html(view, 0.0)).values["robot-name"] == "Picker (r1)"
