"""The files that an arena writes for robots, and those of a robot's votes."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from robrain import Scenario
from robrain.agent.consensus.witness import Kept, Witness
from robrain.agent.host.robot_file import read_robot_file
from robrain.deploy.processes.agent_process import WitnessFile
from robrain.deploy.processes.arena_process import loadable_from_here, open_lines, write_robot_files
from robrain.protocol.clock import VirtualClock
from robrain.protocol.messages.robots.witness_messages import WitnessRefusal, WitnessRequest, WitnessWish
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.world.robot_specs import RobotSpec, RobotType


@pytest.mark.parametrize(
    "endpoints",
    [
        ["tcp/0.0.0.0:7447"],  # any machine
        ["tcp/[::]:7447"],
        ["tcp/192.168.0.1:7447"],
        ["tcp/127.0.0.1:7447", "tcp/192.168.0.1:7447"],  # one of them is enough
        ["tcp/robot.local:7447"],  # a name may lead anywhere
        ["ws/127.0.0.1:7447"],  # not known to be private
        [],
    ],
)
def test_no_folder_is_open_where_others_could_ask(endpoints, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert loadable_from_here(endpoints) == []


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:0", "tcp/[::1]:7447", "tcp/127.1.2.3:1"])
def test_on_loopback_the_folder_of_the_start_is_open(endpoint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert loadable_from_here([endpoint]) == [tmp_path]


def test_the_whole_disk_is_never_open(monkeypatch):
    monkeypatch.chdir("/")
    assert loadable_from_here(["tcp/127.0.0.1:7447"]) == []


def test_serial_lines_are_pseudo_terminals_that_the_robots_files_name(tmp_path):
    lidar = {"lidar": {"protocol": "ld19"}, "imu": {"upside_down": True}}
    specs = (RobotSpec(), RobotSpec(type=RobotType.SERIAL), RobotSpec(type=RobotType.SERIAL, hardware=lidar))
    world = Scenario.builtin("arena_small").replace(robots=3, roster=specs).world()
    with open_lockstep_session() as session, ExitStack() as closing:
        wire = Endpoint(session, "t", VirtualClock(), Drive.LOCKSTEP)
        closing.callback(wire.close)
        lines = open_lines(wire, world, tmp_path, closing)
        assert [plug.path.name for plug in lines] == ["r2-base", "r3-lidar", "r3-base", "r3-imu"]
        assert all(plug.path.is_char_device() for plug in lines)
        paths = write_robot_files(world, tmp_path, team="t", connect="tcp/127.0.0.1:1", lines=lines)
    first, second, third = map(read_robot_file, paths)
    assert "port" not in first.parameters["mocdevice"]
    assert second.robot.roles == {"mocdevice": "serial_base"}
    assert second.parameters["mocdevice"]["port"] == str(tmp_path / "r2-base")
    assert third.robot.roles == {"scan": "ld19", "mocdevice": "serial_base", "imu": "serial_imu"}
    assert third.parameters["imu"] == {"port": str(tmp_path / "r3-imu"), "rate_hz": 100.0, "upside_down": True}
    assert third.parameters["mocdevice"]["port"] == str(tmp_path / "r3-base")
    assert third.parameters["scan"]["port"] == str(tmp_path / "r3-lidar")
    assert not any(plug.path.exists() for plug in lines)


KEPT = Kept(election=4, journal="a", began_ns=7, before="b", number=2, holders=["a", "b"])


def test_what_was_written_is_read_and_replaced_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "state" / "witness.json"
    file = WitnessFile(path)
    assert file.read() == Kept()
    file.write(KEPT)
    assert WitnessFile(path).read() == KEPT
    file.write(Kept(election=5))
    assert WitnessFile(path).read() == Kept(election=5)
    assert [one.name for one in path.parent.iterdir()] == ["witness.json"]


@pytest.mark.parametrize("damaged", [b"", b"{", b"[1, 2]", b'{"election": -1}', b"\xff\xfe"])
def test_a_damaged_file_is_named_and_its_robot_elects_nobody(damaged: bytes, tmp_path: Path) -> None:
    path = tmp_path / "witness.json"
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match=r"witness.json: .*if no coordinator was ever elected, remove it"):
        WitnessFile(path).read()
    asked = WitnessRequest(wish=WitnessWish.ELECT, election=9, journal="a", forced=True)
    assert Witness(WitnessFile(path), 0).answer(asked, 10**10).refusal is WitnessRefusal.UNWRITABLE
    assert path.read_bytes() == damaged
