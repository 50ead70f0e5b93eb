"""The emergency halt in live: nothing that a plugin does delays it."""

import inspect
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from robrain.agent.host import robot_halts
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import PluginThreads
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_COMMAND, HOST_HALT, CommandRequest, HaltRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_session
from robrain.protocol.workers import OwnedThread, close_threads
from tests.patient_endpoint import PatientEndpoint
from tests.waiting import PATIENCE_S, until

ANSWERING_THREADS = inspect.signature(Endpoint).parameters["workers"].default
"""Of one queryable of a host."""
ROBOT = """
    import threading
    from robrain.agent.plugin import unlocked

    RELEASE = threading.Event()
    INSIDE = threading.Event()
    HALTED = []
    STUCK = []

    class Wheels(Device):
        driven_by = ""
        def emergency_halt(self):
            HALTED.append("wheels")
            self.driven_by = ""
        @external
        def drive(self) -> None:
            INSIDE.set()
            RELEASE.wait(600)
            self.driven_by = "a call that was under way"

    class Hanging(Device):
        def emergency_halt(self):
            HALTED.append("hanging")
            RELEASE.wait(600)

    class Raising(Device):
        def emergency_halt(self): raise OSError("the bus is gone")

    class Above(Behavior):
        def emergency_halt(self): HALTED.append("above")

    class Deaf(Device):
        @external
        @unlocked
        def wait(self) -> None:
            STUCK.append("deaf")
            RELEASE.wait(600)
"""


class Robot:
    """A host in live, and an operator beside it."""

    def __init__(self, place: Path, *load: str) -> None:
        self.session = open_session(mode="peer", listen=["tcp/127.0.0.1:0"])
        robot_file = RobotFile(robot=RobotTable("r1", places=[str(place)], load=list(load)))
        self.host = AgentHost(robot_file, Path(), self.session, LiveClock(), Drive.LIVE)
        self.wire = PatientEndpoint(self.session, "default", LiveClock(), Drive.LIVE, workers=8)
        self.states = Inbox(every=True)
        self.wire.subscribe(self.states, ROBOT_STATE)
        self.threads = PluginThreads(self.host)
        self.host.start()
        self.threads.follow()
        self.halts = self.wire.publisher(HALT)

    @property
    def code(self):
        """The globals of the module that its plugins are in."""
        plugin = next(tag.plugin for tag in self.host.manager.plugins.values())
        return vars(sys.modules[type(plugin).__module__])

    def close(self) -> None:
        self.threads.stop()
        self.host.close()
        self.wire.close()
        self.session.close()


@pytest.fixture
def start(bench, monkeypatch) -> Iterator[type[Robot]]:
    monkeypatch.setattr(robot_halts, "LIMIT_S", 3.0)  # who does not hang is not late on a busy machine either
    robots = []
    bench.code("robot", ROBOT)
    for name in ("wheels", "hanging", "raising", "above", "deaf"):
        bench.manifest(name, f"robot:{name.capitalize()}", visibility=["command"], hang_s=PATIENCE_S)

    def start(*load):
        robots.append(Robot(bench.place, *load))
        return robots[-1]

    yield start
    for robot in robots:
        robot.code["RELEASE"].set()
        robot.close()


def halt(robot):
    return robot.wire.ask(HOST_HALT, HaltRequest(by="ann"), robot="r1")


@pytest.mark.slow
def test_plugins_that_hang_or_fail_while_they_are_halted_hold_up_no_other(start):
    robot = start("hanging", "raising", "wheels", "above")
    answer = halt(robot)
    assert not robot.code["RELEASE"].is_set()  # it came while one of them was still stuck
    assert set(answer.not_halted) == {"hanging", "raising"}
    halted = robot.code["HALTED"]
    assert set(halted[:-1]) == {"hanging", "wheels"}
    assert halted[-1] == "above"
    for _ in range(2):
        assert set(halt(robot).not_halted) == {"hanging", "raising"}
    assert halted.count("hanging") == 1, "what still hangs is not entered again"
    assert halted.count("wheels") == 3


def test_a_call_that_was_under_way_does_not_undo_a_halt(start):
    robot = start("wheels")
    code = robot.code
    call = OwnedThread(
        "call", lambda: robot.wire.ask(ROBOT_CALL, robot="r1", plugin="wheels", function="drive", timeout_s=PATIENCE_S)
    )
    assert code["INSIDE"].wait(PATIENCE_S)
    halt(robot)
    assert code["HALTED"] == ["wheels"]
    code["RELEASE"].set()
    call.close(PATIENCE_S)
    until(lambda: code["HALTED"] == ["wheels", "wheels"])
    until(lambda: robot.host.manager.get("wheels").plugin.driven_by == "")


def test_the_robot_says_that_it_is_halted_without_a_step_of_its_host(start):
    robot = start("wheels")
    robot.halts.put(Halt(halted=True, by="ann"))
    until(lambda: any(received.message.halted for received in robot.states.drain()))
    robot.halts.put(Halt(halted=False, by="ann"))
    until(lambda: any(not received.message.halted for received in robot.states.drain()))


def test_a_robot_whose_every_answering_thread_is_stuck_is_halted_by_a_query_all_the_same(start):
    robot = start("deaf", "wheels")

    def wait():
        with suppress(CallError):
            request = CommandRequest(text="call deaf wait()")
            robot.wire.ask(HOST_COMMAND, request, robot="r1", timeout_s=PATIENCE_S)

    calls = [OwnedThread("call", wait) for _ in range(ANSWERING_THREADS)]
    until(lambda: len(robot.code["STUCK"]) == ANSWERING_THREADS, "an answering thread is free")
    assert halt(robot).halted
    assert all(call.is_alive for call in calls)
    robot.code["RELEASE"].set()
    close_threads(calls, PATIENCE_S)
