"""Each check of `robrain doctor`: when it is good, when it is wrong, and what it says then."""

import os
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import pytest
import zenoh

from robrain.agent.errors import PackageMissing
from robrain.deploy.machine.doctor import (
    Check,
    CheckName,
    RobotFound,
    check_address,
    check_can,
    check_clock,
    check_devices,
    check_extras,
    check_grid,
    check_key_space,
    check_name_free,
    check_port,
    check_robot_file,
    check_robot_ports,
    check_router,
    check_versions,
    holders,
    members,
    stamp_skews_s,
)
from robrain.deploy.processes.name_claim import claim_robot
from robrain.protocol.clock import NS_PER_S, LiveClock
from robrain.protocol.extras import MissingPackage
from robrain.protocol.messages.robots.plugin_messages import ProcessInfo
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.table.topics import COORDINATOR_STATE, ROBOT_WHO
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from robrain.sim.peripherals.line_plug import SerialPlug
from tests.waiting import until

TEAM = "default"
CAN = """
[robot]
name = "r1"
load = ["mocdevice"]
[parameters.mocdevice]
interface = "socketcan"
channel = "can7"
"""
PORT = '[robot]\nname = "r1"\nload = ["tcp_socket"]\n[parameters.tcp_socket]\nenabled = true\nport = {}\n'


@pytest.fixture(scope="module")
def hub() -> Iterator[zenoh.Session]:
    session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    yield session
    session.close()


@pytest.fixture(scope="module")
def endpoints(hub) -> list[str]:
    return listening_at(hub)[:1]


@pytest.fixture
def taken() -> Iterator[int]:
    """A port on which somebody listens that is no router."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@pytest.fixture
def free() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def robot(tmp_path: Path, text: str) -> RobotFound:
    path = tmp_path / "r1.toml"
    path.write_text(text)
    found, said = check_robot_file(path)
    assert found is not None, said
    return found


def wrong(check: Check, name: CheckName, *parts: str) -> None:
    """It is wrong, says so in these words, and what to do."""
    assert (check.name, check.ok) == (name, False)
    assert check.remedy
    for part in parts:
        assert part in check.sentence


def test_router_that_answers(endpoints) -> None:
    assert check_router(endpoints).ok


def test_router_that_cannot_be_reached(free) -> None:
    wrong(check_router([f"tcp/127.0.0.1:{free}"]), CheckName.ROUTER, f"nobody listens at tcp/127.0.0.1:{free}")


@pytest.mark.slow
def test_something_that_is_no_router(taken) -> None:
    wrong(check_router([f"tcp/127.0.0.1:{taken}"]), CheckName.ROUTER, "admits no client")


def test_key_space_that_is_open(endpoints) -> None:
    assert check_key_space(endpoints, TEAM, "r1").ok


@pytest.mark.slow
def test_key_space_that_the_router_denies(monkeypatch) -> None:
    monkeypatch.setattr("robrain.deploy.machine.doctor.ASK_S", 0.5)
    config = zenoh.Config()
    rules = '{"enabled": true, "default_permission": "deny", "rules": [], "subjects": [], "policies": []}'
    for key, value in {
        "mode": '"router"',
        "listen/endpoints": '["tcp/127.0.0.1:0"]',
        "scouting/multicast/enabled": "false",
        "adminspace/enabled": "true",
        "access_control": rules,
    }.items():
        config.insert_json5(key, value)
    with closing(zenoh.open(config)) as router:
        found = check_key_space(listening_at(router)[:1], TEAM, "r1")
    wrong(found, CheckName.KEY_SPACE, "r1 of team default", "access rules")


@pytest.mark.parametrize(
    ("skews_s", "words"),
    [
        ([-30.2, -30.05], "this machine's clock is 30.1 s ahead of the team's"),
        ([1.9, 2.0], "this machine's clock is 2.0 s behind the team's"),
    ],
)
def test_clock_that_is_wrong(skews_s: list[float], words: str) -> None:
    wrong(check_clock(skews_s), CheckName.CLOCK, words)


def test_clock_that_agrees_though_one_message_was_late() -> None:
    assert check_clock([-0.01, -1.8]).ok
    assert check_clock([]).ok is None


@pytest.mark.parametrize("ahead_s", [0.0, 60.0])
def test_stamps_of_the_coordinator_are_heard_even_from_the_future(hub, endpoints, ahead_s: float) -> None:
    clock = SimpleNamespace(now_ns=lambda: LiveClock().now_ns() + round(ahead_s * NS_PER_S))
    wire = Endpoint(hub, "clocks", clock, Drive.LIVE)
    with closing(wire), closing(open_session(connect=endpoints)) as session:
        states = wire.publisher(COORDINATOR_STATE)
        from threading import Event, Thread

        ended = Event()

        def say() -> None:
            while not ended.wait(0.02):
                states.put(TeamState(robots=[]))

        speaker = Thread(target=say)
        speaker.start()
        try:
            found = stamp_skews_s(session, "clocks")
        finally:
            ended.set()
            speaker.join()
    assert max(found) == pytest.approx(ahead_s, abs=5.0)
    assert len(found) == 3


def test_versions_that_differ_or_are_not_told() -> None:
    here, there = ProcessInfo("a", 1, "z", "1.2.0"), ProcessInfo("b", 2, "y", "1.1.0")
    assert check_versions("1.2.0", {"r1": here}).ok
    assert check_versions("1.2.0", {}).ok is None
    old = ProcessInfo("c", 3, "x")
    said = check_versions("1.2.0", {"r1": here, "r2": there, "r3": old})
    wrong(said, CheckName.VERSION, "this machine has robrain 1.2.0; r2 has 1.1.0, r3 has an older one")


def test_robots_say_who_they_are_and_which_version_they_have(hub, endpoints) -> None:
    with closing(open_session(connect=endpoints)) as session, claim_robot(session, TEAM, "r5") as claim:
        assert claim.acquire(lambda _: None, lambda: False)
        found = until(lambda: members(hub, TEAM))
        assert found["r5"].version
        assert found["r5"].pid == os.getpid()


def test_two_of_one_name(hub, endpoints) -> None:
    wires = []
    with closing(open_session(connect=endpoints)) as first, closing(open_session(connect=endpoints)) as second:
        for number, session in enumerate((first, second)):
            wire = Endpoint(session, TEAM, LiveClock(), Drive.LIVE)
            info = ProcessInfo(f"host{number}", number, f"zid{number}")
            wire.answer(ROBOT_WHO, lambda _, info=info: info, robot="r6")
            wires.append(wire)
        found = until(lambda: len(them := holders(hub, TEAM, "r6")) == 2 and them)
        said = check_name_free("r6", found)
        for wire in wires:
            wire.close()
    wrong(said, CheckName.NAME, "2 processes say that they are r6: process 0 on host0")


def test_name_that_another_machine_has_and_the_robots_own(tmp_path) -> None:
    (tmp_path / "7").mkdir()
    info = ProcessInfo("here", 7, "zid")
    assert check_name_free("r1", [], "here", tmp_path).ok
    assert check_name_free("r1", [info], "here", tmp_path).ok
    wrong(check_name_free("r1", [info], "there", tmp_path), CheckName.NAME, "another machine has the name r1")


@pytest.mark.slow
def test_port_that_is_taken(taken) -> None:
    endpoint = f"tcp/127.0.0.1:{taken}"
    wrong(check_port("the hub", endpoint), CheckName.PORT, f"the hub cannot listen at {endpoint}: the port is taken")


def test_port_that_is_free_or_has_the_router_itself(free, endpoints) -> None:
    assert check_port("the hub", f"tcp/127.0.0.1:{free}").ok
    assert check_port("the hub", endpoints[0]).sentence == f"the hub is at {endpoints[0]} already"


@pytest.mark.slow
def test_port_of_a_robots_plugin_that_is_taken(tmp_path, taken) -> None:
    [said] = check_robot_ports(robot(tmp_path, PORT.format(taken)))
    wrong(said, CheckName.PORT, "tcp_socket cannot listen at")


def test_address_of_this_machine_and_of_another() -> None:
    assert check_address("base", "127.0.0.1").ok
    wrong(check_address("base", "192.0.2.77"), CheckName.ADDRESS, "does not have the address 192.0.2.77 of host base")


def test_can_interface_that_is_absent_down_or_up(tmp_path) -> None:
    found = robot(tmp_path, CAN)
    [absent] = check_can(found, tmp_path)
    wrong(absent, CheckName.CAN, "there is no CAN interface can7, which mocdevice needs")
    (tmp_path / "can7").mkdir()
    (tmp_path / "can7" / "flags").write_text("0x80\n")
    [down] = check_can(found, tmp_path)
    wrong(down, CheckName.CAN, "can7, which mocdevice needs, is down")
    (tmp_path / "can7" / "flags").write_text("0x81\n")
    assert check_can(found, tmp_path)[0].ok


def test_extra_that_is_not_installed(tmp_path) -> None:
    found = robot(tmp_path, '[robot]\nname = "r1"\nload = ["planner", "driver"]\n')

    def import_plugin(manifest) -> None:
        if manifest.name == "planner":
            raise PackageMissing(manifest.path, manifest.module_name, MissingPackage("scipy", "navigation"))

    said = check_extras(found, import_plugin)
    wrong(said, CheckName.EXTRA, "planner need robrain[navigation]")
    assert said.remedy == "pip install 'robrain[navigation]'"
    assert check_extras(found).ok


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[robot]\n", "missing required field `name`"),
        ('[robot]\nname = "r1"\nload = ["nothing"]\n', "no plugin nothing in any place"),
        ('[robot]\nname = "r1"\n[parameters.nothing]\nx = 1\n', "[parameters.nothing]: no plugin of that name"),
    ],
)
def test_robot_file_that_is_wrong(tmp_path, text: str, said: str) -> None:
    path = tmp_path / "r1.toml"
    path.write_text(text)
    found, check = check_robot_file(path)
    assert found is None
    wrong(check, CheckName.FILE, said)


def test_file_that_does_not_say_the_map(tmp_path) -> None:
    said = check_grid(robot(tmp_path, '[robot]\nname = "r1"\n'))
    assert (said.name, said.ok) == (CheckName.MAP, None)
    grid = "resolution_m = 0.1\norigin_x_m = 0.0\norigin_y_m = 0.0\nwidth_m = 9.0\nheight_m = 5.0\n"
    said = check_grid(robot(tmp_path, f'[robot]\nname = "r1"\n[parameters.mapper]\n{grid}'))
    assert said.sentence == "the robot maps 9 × 5 m from (0, 0)"
    assert check_grid(robot(tmp_path, CAN)).ok


@pytest.mark.parametrize(
    ("plugin", "parameters", "words"),
    [
        ("mocdevice", 'interface = "virtual"\nframes = { dbc = "gone.dbc" }', "gone.dbc"),
        ("mocdevice", 'interface = "socketcan"\nchannel = "can77"', "no CAN bus at socketcan:can77"),
        ("scan", 'port = "/dev/gone"\n[robot.roles]\nscan = "ld19"', "no serial line at /dev/gone"),
        ("mocdevice", 'interface = "virtual"\nsilent_s = -1.0', "silent_s"),
    ],
)
def test_device_that_cannot_open_what_its_parameters_name(tmp_path, plugin, parameters, words) -> None:
    found = robot(tmp_path, f'[robot]\nname = "r1"\nload = ["{plugin}", "home"]\n[parameters.{plugin}]\n{parameters}\n')
    wrong(check_devices(found, tmp_path)[0], CheckName.DEVICE, f"{plugin} cannot start", words)


def test_devices_are_opened_and_closed_again(tmp_path) -> None:
    plug = SerialPlug(tmp_path / "base")
    text = '[robot]\nname = "r1"\nload = ["mocdevice"]\n[robot.roles]\nmocdevice = "serial_base"\n'
    found = robot(tmp_path, f'{text}[parameters.mocdevice]\nport = "{plug.path}"\n')
    (check,) = check_devices(found, tmp_path)
    assert check == Check(CheckName.DEVICE, True, "devices that open what their parameters name: mocdevice")
    plug.pull_out()
