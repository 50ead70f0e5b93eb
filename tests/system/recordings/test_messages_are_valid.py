"""Messages on the wire are valid by the schema of `robrain wire`, as an independent validator finds."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import zenoh
from mcap.reader import make_reader

from robrain import BatterySpec, ChargerSpec, RobotHardware, Scenario, Team
from robrain.protocol.keys import DEFAULT_TEAM
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition, DoorState
from robrain.protocol.model.zone import Zone, ZoneKind
from robrain.protocol.table.topics import all_topics, topic_of
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from robrain.sim.lockstep.lockstep import LockstepRun, LockstepTransport
from robrain.sim.world.link_spec import LinkSpec
from tests.system.valid_messages import counts_by_ajv
from tests.waiting import until

pytestmark = pytest.mark.system

LATER_S = 40.0
SQUARE = ((4.0, 2.0), (5.0, 2.0), (5.0, 3.0), (4.0, 3.0))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of a team that does all that a lockstep run can do."""
    path = tmp_path_factory.mktemp("valid") / "run.mcap"
    battery = BatterySpec(capacity_wh=2.5, soc_at_start=0.45)
    scenario = Scenario.builtin("arena_small").replace(
        robots=3, motes=6, hardware=RobotHardware(battery=battery), chargers=(ChargerSpec(place_m=(0.6, 5.2)),)
    )
    run = LockstepRun(scenario.world(), record=path, listen="tcp/127.0.0.1:0")
    with Team(LockstepTransport(run), by="script") as team:
        team.change_zones(Zone(name="slow", kind=ZoneKind.SPEED_LIMIT, corners_m=SQUARE, speed_m_s=0.2))
        team.run_for(6.0)
        team.submit("inspect", id="picture", place=(4.2, 3.0), priority=50.0, parameters={"look_at": (7.5, 5.0)})
        team.submit("visit", id="first", place=(1.0, 1.0), priority=5.0, deadline_s=100.0)
        team.submit("visit", id="second", place=(3.6, 4.8), after=["first"])
        team.submit("visit", id="together", place=(6.0, 3.0), service_s=1.0, robots=2)
        team.submit("sense", id="warmth", place=(2.0, 2.0), parameters={"quantity": "temperature_c"})
        watch = {"duration_s": 8.0, "interval_s": 2.0, "quantity": "temperature_c"}
        reading = next(team.readings(20.0))
        team.submit("monitor", id="watch", place=reading.place, parameters=watch)
        team.submit("collect", id="mule", place=reading.place, parameters={"mote": reading.mote})
        team.run_for(4.0)
        assert set(team.halt(reason="a person").confirmed) == {"r1", "r2", "r3"}
        team.run_for(0.5)
        team.resume()
        team.cancel("together")
        ask_from_outside(run, team)
        team.run_for(LATER_S)
    return path


@pytest.fixture(scope="module")
def without_centre(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some seconds of a team with a radio, whose coordinator ends."""
    path = tmp_path_factory.mktemp("valid") / "no_centre.mcap"
    scenario = Scenario.builtin("arena_small").replace(
        links=LinkSpec(range_m=20.0), hardware=RobotHardware(consensus=True)
    )
    run = scenario.open(scenario.world(), record=path)
    with Team(LockstepTransport(run), by="script") as team:
        team.run_for(2.0)
        assert run.publish_exploration_left() is not None
        run.end_coordinator()
        team.run_for(3.0)
    return path


def ask_from_outside(run: LockstepRun, team: Team) -> None:
    """Have another session stop a robot: such a run is marked, and its recording says what came from outside."""
    key = ROBOT_CALL.key("default", robot="r1", plugin="driver", function="stop")
    with open_session(connect=run.listening_at) as other:
        replies = other.get(key, zenoh.handlers.FifoChannel(1), payload=b"[]")
        reply = until(replies.try_recv, "a call from outside has no reply", step=lambda: team.run_for(0.02))
    assert reply.ok is not None
    keeper = Endpoint(run.session, DEFAULT_TEAM, run.clock, Drive.LOCKSTEP)
    keeper.publisher(DOOR_STATE, door="gate").put(DoorState(door="gate", position=DoorPosition.CLOSED))
    team.run_for(0.5)


def told(path: Path, topic: str) -> list[Any]:
    """The messages of one topic."""
    with path.open("rb") as stream:
        return [
            json.loads(message.data)
            for _, channel, message in make_reader(stream).iter_messages()
            if (known := topic_of(channel.topic)) is not None and known[0].name == topic
        ]


def test_the_run_has_halts_charging_and_tasks_of_many_kinds_and_states(recording: Path) -> None:
    assert [message["halted"] for message in told(recording, "halt")][-1] is False
    states = told(recording, "robot_state")
    assert {True, False} == {state["halted"] for state in states}
    assert {"inspect", "recharge", "visit"} <= {state["behavior"] for state in states}
    events = told(recording, "task_event")
    assert {"collect", "inspect", "monitor", "sense", "visit"} <= {event["task"]["kind"] for event in events}
    assert {"queued", "offered", "running", "done", "cancelled"} <= {event["state"] for event in events}
    assert any(event.get("reason") for event in events)


def test_every_message_of_a_run_is_valid_and_no_topic_is_missing(recording: Path, without_centre: Path) -> None:
    counts = Counter[str]()
    for path in (recording, without_centre):
        counts += counts_by_ajv(path)
    found = {topic_of(key)[0].name for key in counts}  # type: ignore[index]
    assert found == {topic.name for topic in all_topics() if topic.recorded and topic.message is not None}
    assert sum(counts.values()) > 1000
