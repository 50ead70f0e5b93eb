"""`robrain door` with a Modbus TCP server on loopback, as another process than the team's."""

import asyncio
import socket
import threading
from collections.abc import Iterator

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from robrain.client.door_keeper import DoorUnavailable
from robrain.deploy.processes.modbus_door import ModbusDoor
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition
from robrain.protocol.model.claim import Reservation
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.system.conftest import Commands
from tests.waiting import until

pytestmark = pytest.mark.system

COIL, INPUT, WRITE_COIL, READ_INPUTS = 3, 7, 5, 2


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Controller:
    """A door's controller: a real Modbus TCP server; its input follows its coil, unless the door is stuck."""

    def __init__(self, port: int = 0) -> None:
        self.is_ordered = self.is_stuck = False
        self.port = port or _free_port()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run)
        self._listens = threading.Event()
        self._thread.start()
        assert self._listens.wait(10.0)

    def close(self) -> None:
        if self._thread.is_alive():
            asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(10.0)
            self._thread.join(10.0)

    def _run(self) -> None:
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        def bits(address: int) -> list[SimData]:
            return [SimData(address, values=[False], datatype=DataType.BITS)]

        registers = [SimData(0, values=[0], datatype=DataType.REGISTERS)]
        device = SimDevice(1, (bits(COIL), bits(INPUT), registers, registers), action=self._act)
        self._server = ModbusTcpServer(device, address=("127.0.0.1", self.port))
        await self._server.serve_forever(background=True)
        self._listens.set()
        await self._server.serving

    async def _act(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        current: list[int],
        written: list[int] | list[bool] | None,
    ) -> None:
        if function == WRITE_COIL and written is not None:
            self.is_ordered = bool(written[0])
        if function == READ_INPUTS:
            current[0] = (self.is_ordered and not self.is_stuck) << INPUT


@pytest.fixture
def controller() -> Iterator[Controller]:
    controller = Controller()
    yield controller
    controller.close()


def test_the_driver_switches_the_coil_and_reads_the_input(controller: Controller) -> None:
    door = ModbusDoor("127.0.0.1", controller.port, coil=COIL, input_=INPUT)
    try:
        door.open()
        assert (controller.is_ordered, door.state()) == (True, True)
        door.close()
        assert (controller.is_ordered, door.state()) == (False, False)
    finally:
        door.disconnect()


def test_a_refusal_and_a_lost_connection_are_reported_and_the_driver_connects_again(controller: Controller) -> None:
    other = ModbusDoor("127.0.0.1", controller.port, coil=COIL + 400, input_=INPUT)
    with pytest.raises(DoorUnavailable, match="the controller refuses"):
        other.open()
    other.disconnect()
    door = ModbusDoor("127.0.0.1", controller.port, coil=COIL, input_=INPUT)
    door.open()
    controller.close()
    with pytest.raises(DoorUnavailable, match="the controller"):
        door.open()
    second = Controller(controller.port)
    try:
        door.open()
        assert second.is_ordered
    finally:
        door.disconnect()
        second.close()


class Team:
    """A router, and a robot that requests a door."""

    def __init__(self) -> None:
        self._session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        [self.endpoint] = listening_at(self._session)
        self._wire = Endpoint(self._session, "default", LiveClock(), Drive.LIVE)
        self._states = self._wire.publisher(ROBOT_STATE, robot="r1")
        self._inbox = Inbox()
        self._wire.subscribe(self._inbox, DOOR_STATE)
        self.requests = True
        self.position: DoorPosition | None = None

    def step(self) -> None:
        own = Reservation(robot="r1", zones=("gate",), since_ns=1, has=True)
        self._states.put(RobotState(robot="r1", reservations=(own,) if self.requests else ()))
        for received in self._inbox.drain():
            self.position = received.message.position

    def until(self, position: DoorPosition) -> None:
        until(lambda: self.position is position, f"the door is not {position}", step=self.step, pause_s=0.05)

    def close(self) -> None:
        self._wire.close()
        self._session.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def team() -> Iterator[Team]:
    team = Team()
    yield team
    team.close()


def test_the_command_opens_a_door_for_a_robot_and_reports_one_that_is_stuck(
    controller: Controller, team: Team, commands: Commands
) -> None:
    options = ["--coil", str(COIL), "--input", str(INPUT), "--timeout-s", "1", "--connect", team.endpoint]
    process = commands.start("door", "gate", "127.0.0.1", "--port", str(controller.port), *options)
    commands.line_with(process, "door: gate of team default")
    team.until(DoorPosition.OPEN)
    team.requests = False
    team.until(DoorPosition.CLOSED)
    assert not controller.is_ordered
    controller.is_stuck = team.requests = True
    team.until(DoorPosition.FAILED)
    controller.is_stuck = False
    team.until(DoorPosition.OPEN)
