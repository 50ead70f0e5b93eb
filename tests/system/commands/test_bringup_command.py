"""`robrain bringup` against a live arena: the command as a person types it, with faults in the robot's file."""

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
import tomli_w

from robrain.plugins.device.mocdevice.frame_map import read_dbc
from tests.deploy.bringup.brought_up import YARD
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

ROBOT = """
[[robots]]
type = "two_wheels"
place_m = [3.0, 3.0]
hardware = { lidar = { mount = { yaw_rad = 1.5708 } } }
"""
WATCHDOG_FRAMES = 15
"""Encoder frames, one each 20 ms of the arena's time, in which wheels may turn on: 300 ms."""
FLIGHT_FRAMES = 5
"""Frames on their way when the process is killed."""
STALLED = ("no data from the wheel encoders", "no turn of the lidar", "no encoder frame")
"""What is said where the arena of a busy machine stood still."""


class Yard:
    """An arena with one robot, and its file."""

    def __init__(self, commands: Commands) -> None:
        self.commands = commands
        (commands.folder / "yard.toml").write_text(YARD + ROBOT)
        self.arena = commands.start("arena", "yard.toml", "--robot-files", "robots")
        commands.line_with(self.arena, "arena: yard at ")
        self.file = commands.folder / "robots" / "r1.toml"
        self.text = self.file.read_text()

    def spoil(self) -> None:
        """Swap the encoders."""
        said = tomllib.loads(self.text)
        said["parameters"]["mocdevice"]["frames"]["encoders"].reverse()
        text = tomli_w.dumps(said)
        assert "wheel_radius_m = 0.05\n" in text
        self.file.write_text(text.replace("wheel_radius_m = 0.05\n", "wheel_radius_m = 0.05 # by the shop\n"))


class Wheels:
    """Listens to the left wheel's encoder on the robot's bus."""

    def __init__(self, yard: Yard) -> None:
        self._bus = can.Bus(interface="zenoh", channel="r1/can0", connect=yard.commands.hub.endpoint)
        self._message = read_dbc("two_wheels").get_message_by_name("LeftEncoder")
        self._last: int | None = None

    def turn(self) -> bool:
        """Whether the wheel has turned since the frame before; waits for a frame."""
        while True:
            frame = self._bus.recv(PATIENCE_S)
            assert frame is not None
            if frame.arbitration_id != self._message.frame_id:
                continue
            counts = int(self._message.decode(frame.data)["left_counts"])
            before, self._last = self._last, counts
            return before not in (None, counts)

    def close(self) -> None:
        self._bus.shutdown()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Yard]:
    commands = Commands(tmp_path_factory.mktemp("yard"))
    yield Yard(commands)
    commands.stop_all()


@pytest.fixture
def yard(shared: Yard) -> Yard:
    """With the robot's file as the arena wrote it."""
    shared.file.write_text(shared.text)
    return shared


@pytest.fixture
def wheels(yard: Yard) -> Iterator[Wheels]:
    found = Wheels(yard)
    yield found
    found.close()


def test_a_robot_is_brought_up_live_and_its_file_corrected(yard: Yard) -> None:
    while True:  # an arena that stands still for half a second ends a motion, as it should
        yard.spoil()
        words = ("bringup", str(yard.file), "--yes", "--no-floor", "--json")
        # An interpreter of its own: forked from one that has loaded numpy, its native threads abort at the very end.
        done = yard.commands.run(*words, PYTHONFAULTHANDLER="1")
        if not any(text in done.stderr for text in STALLED):
            break
    assert done.returncode == 1, done.stderr
    report = json.loads(done.stdout)
    wrong = {finding["found"] for finding in report["findings"] if finding["ok"] is False}
    assert wrong == {"encoders_swapped"}, done.stderr
    assert "WRONG   wheels: encoders of wheels are swapped" in done.stderr
    text = yard.file.read_text()
    corrected, before = (
        [
            (each["frame"], each["signals"])
            for each in tomllib.loads(file)["parameters"]["mocdevice"]["frames"]["encoders"]
        ]
        for file in (text, yard.text)
    )
    assert corrected == before
    assert "# by the shop" in text
    assert "by the shop" in Path(report["backup"]).read_text()


def test_the_wheels_stand_within_300_ms_after_its_process_is_killed(yard: Yard, wheels: Wheels) -> None:
    words = ("bringup", str(yard.file), "--yes", "--no-air", "--rounds", "0")
    process = yard.commands.start(*words)

    def moves() -> bool:
        """On a busy machine it may find no frames, and end."""
        nonlocal process
        if process.poll() is not None:
            process = yard.commands.start(*words)
        return wheels.turn()

    until(moves, "the robot does not move", pause_s=0.0)
    for _ in range(50):
        wheels.turn()
    assert wheels.turn()
    process.kill()
    turned = [wheels.turn() for _ in range(100)]
    assert not any(turned[WATCHDOG_FRAMES + FLIGHT_FRAMES :])
    assert process.wait(PATIENCE_S) != 0


def test_it_does_not_begin_while_the_robots_agent_runs(yard: Yard) -> None:
    agent = yard.commands.start("agent", str(yard.file))
    yard.commands.line_with(agent, "is up with")
    done = yard.commands.run_here("bringup", str(yard.file), "--yes")
    assert done.returncode != 0
    assert "r1" in done.stderr
    assert "bus:" not in done.stdout
    assert "Traceback" not in done.stderr
