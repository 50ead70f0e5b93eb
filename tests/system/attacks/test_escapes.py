"""A robot and an operator who put what steers a terminal into every text: commands and logs only show it."""

import re
import threading
from collections.abc import Iterator
from contextlib import closing

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots import plugin_messages, robot_messages
from robrain.protocol.messages.robots.host_messages import HOST_HALT
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, LogRecord, PluginInfo, ProcessInfo
from robrain.protocol.messages.robots.robot_messages import BatteryState, PluginFault, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.system.conftest import Commands

pytestmark = pytest.mark.system
EVIL = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202eline\nline\r"
STEERS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")
PERIOD_S = 0.1


class EvilRobot:
    """A member whose every text is evil, in a thread of its own until it is closed."""

    def __init__(self) -> None:
        self._session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        self.wire = Endpoint(self._session, "default", LiveClock(), Drive.LIVE)
        self.wire.token(robot_messages.ROBOT_ALIVE, robot="r1")
        self.wire.answer(
            plugin_messages.ROBOT_WHO, lambda _: ProcessInfo(host=EVIL, pid=1, zid=EVIL, version=EVIL), robot="r1"
        )
        self.wire.answer(ROBOT_OFFER, self._fail, robot="r1")
        self.wire.answer(plugin_messages.ROBOT_PLUGINS, lambda _: [self._plugin()], robot="r1")
        self.wire.answer(plugin_messages.ROBOT_CALL, self._fail, robot="r1", plugin="lamp", function="light")
        self.wire.answer(HOST_HALT, self._fail, robot="r1")
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def endpoint(self) -> str:
        return listening_at(self._session)[0]

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.wire.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def _run(self) -> None:
        state, log = (
            self.wire.publisher(topic, robot="r1") for topic in (robot_messages.ROBOT_STATE, plugin_messages.ROBOT_LOG)
        )
        while not self._stop.wait(PERIOD_S):
            state.put(
                RobotState(
                    robot="r1",
                    pose=Pose2D(0, 0, 0),
                    radius_m=0.2,
                    behavior=EVIL,
                    battery=BatteryState(
                        voltage_v=24, current_a=1, temperature_c=30, soc=1, remaining_j=1e5, implausible=EVIL
                    ),
                    faulted=[PluginFault(plugin="lamp", why=EVIL)],
                    not_halted=[EVIL],
                    halted_by=[EVIL],
                    lost=EVIL,
                )
            )
            log.put(LogRecord(robot="r1", level=EVIL, source=EVIL, text=EVIL))

    @staticmethod
    def _plugin() -> PluginInfo:
        function = FunctionInfo(name="light", signature=EVIL, doc=EVIL, parameters={"title": EVIL}, returns={})
        return PluginInfo(
            name="lamp",
            level="device",
            state="faulted",
            why=EVIL,
            where=EVIL,
            detail=EVIL,
            doc=EVIL,
            visibility=["*"],
            requires=[EVIL],
            holder=EVIL,
            distribution=EVIL,
            functions=[function],
        )

    @staticmethod
    def _fail(_: object) -> None:
        raise CallError(ErrorCode.FAILED, EVIL, EVIL)


@pytest.fixture
def endpoint() -> Iterator[str]:
    with closing(EvilRobot()) as robot:
        yield robot.endpoint


WORDS = (
    ("status",),
    ("top", "--once"),
    ("top", "--json"),
    ("plugin", "list", "r1"),
    ("plugin", "list", "r1", "--json"),
    ("call", "r1", "lamp", "light"),
    ("call", "r1", "lamp", "light", "--json"),
    ("task", "add", "visit", "--at", "1,1", "--id", "t1"),
    ("task", "add", "visit", "--at", "1,1", "--set", f"x={EVIL}"),
    ("task", "list"),
    ("task", "why", "t1"),
    ("task", "show", "t1"),
    ("task", "cancel", EVIL),
    ("halt", "--by", EVIL, "--reason", EVIL),
    ("halt", "--robot", "r1"),
    ("resume", "--by", EVIL),
)


def test_no_command_and_no_log_lets_text_from_the_wire_steer_the_terminal(commands: Commands, endpoint: str) -> None:
    coordinator = commands.start("coordinator", "--connect", endpoint)
    commands.line_with(coordinator, "of team")
    said = [
        ended.stdout + ended.stderr for ended in (commands.run_here(*words, "--connect", endpoint) for words in WORDS)
    ]
    coordinator.send_signal(2)
    said.append(coordinator.communicate()[0])
    for words, text in zip((*WORDS, ("coordinator",)), said, strict=True):
        assert STEERS.search(text) is None, (words, text)
        assert "\nline" not in text, (words, text)
    assert any("owned" in text for text in said), "nothing evil was shown at all"
