"""What a team says on the wire becomes metrics, and the Grafana dashboard asks for no other."""

import json
import re
from importlib import resources

import pytest
from prometheus_client import CollectorRegistry
from prometheus_client.openmetrics.exposition import generate_latest
from prometheus_client.openmetrics.parser import text_string_to_metric_families

from robrain.deploy.processes.metrics_process import COUNTERS, METRICS, TeamMetrics
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, BatteryState, RobotState
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, TeamState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import TopicStale
from robrain.protocol.refusals import Refusal

BATTERY = BatteryState(voltage_v=12.0, current_a=1.0, temperature_c=20.0, soc=0.42, remaining_j=100.0)
REFUSAL = Refusal(topic="robot_event", key="robrain/t/robot/r1/event/a/b", code="lost", count=7, why="away")


def scrape(metrics):
    """The samples of a scrape, by name and labels."""
    registry = CollectorRegistry()
    registry.register(metrics)
    text = generate_latest(registry).decode()
    return {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_robots_state_becomes_metrics(wire):
    metrics = TeamMetrics(wire)
    wire.token(ROBOT_ALIVE, robot="r1")
    states = wire.publisher(ROBOT_STATE, robot="r1")
    for at_s in (1.0, 1.1, 1.6):
        wire.clock.advance_to(to_ns(at_s))
        states.put(RobotState(robot="r1", battery=BATTERY, halted=True, skipped=3, refused=[REFUSAL]))
    metrics.update()
    wire.clock.advance_to(to_ns(2.0))
    found = metrics_of = {name: family for family in metrics.collect() for name in [family.name]}
    assert set(found) == set(METRICS)
    values = {name: [(each.labels, each.value) for each in family.samples] for name, family in metrics_of.items()}
    r1 = {"robot": "r1"}
    assert values["robrain_robot_up"] == [(r1, 1.0)]
    assert values["robrain_robot_halted"] == [(r1, 1.0)]
    assert values["robrain_robot_soc_ratio"] == [(r1, 0.42)]
    assert values["robrain_robot_state_age_seconds"] == [(r1, pytest.approx(0.4))]
    assert values["robrain_robot_state_period_seconds"] == [(r1, pytest.approx(0.5))]
    assert values["robrain_robot_left_out"] == [(r1, 3)]
    assert values["robrain_messages"] == [({"topic": "robot_state"}, 3)]
    assert values["robrain_refused"] == [({"component": "r1", "topic": "robot_event", "code": "lost"}, 7.0)]
    assert values["robrain_coordinator_up"] == [({}, 0.0)]


def test_what_the_coordinator_says_becomes_metrics_and_open_metrics_reads_them(wire):
    metrics = TeamMetrics(wire)
    wire.token(COORDINATOR_ALIVE)
    wire.publisher(COORDINATOR_STATE).put(
        TeamState(robots=[], known_area_m2=12.5, stale=[TopicStale("robot_state", "r2", 0.7, 0.3)])
    )
    events = wire.publisher(TASK_EVENT)
    changes = (("a", TaskState.QUEUED), ("a", TaskState.RUNNING), ("b", TaskState.QUEUED), ("c", TaskState.DONE))
    for number, (name, state) in enumerate(changes):
        task = Task(id=name, kind="visit", place=Point2D(0.0, 0.0))
        events.put(TaskEvent(change=number, task=task, state=state))
    found = scrape(metrics)
    assert found[("robrain_known_area_square_metres",)] == 12.5
    assert found[("robrain_coordinator_up",)] == 1.0
    assert found[("robrain_topic_stale_seconds", ("sender", "r2"), ("topic", "robot_state"))] == 0.7
    tasks = {state: found[("robrain_tasks", ("state", str(state)))] for state in TaskState}
    wanted = {TaskState.QUEUED: 1.0, TaskState.RUNNING: 1.0, TaskState.DONE: 1.0}
    assert tasks == dict.fromkeys(TaskState, 0.0) | wanted
    assert found[("robrain_messages_total", ("topic", "task_event"))] == 4.0


def test_grafana_dashboard_asks_for_metrics_that_there_are_and_for_all_of_them():
    board = json.loads(
        resources.files("robrain.deploy.machine").joinpath("observability/grafana-dashboard.json").read_text()
    )
    asked = {
        name
        for panel in board["panels"]
        for target in panel["targets"]
        for name in re.findall(r"robrain_\w+", target["expr"])
    }
    assert asked == {f"{name}_total" if name in COUNTERS else name for name in METRICS}
    ids = [panel["id"] for panel in board["panels"]]
    assert len(set(ids)) == len(ids)
