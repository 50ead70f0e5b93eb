"""Each check of `robrain doctor`: when it is good, when it is wrong, and what it says then."""

import json
import os
import socket
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
import zenoh

from robrain.agent.errors import PackageMissing
from robrain.deploy.machine import doctor, team_checks
from robrain.deploy.machine.team_checks import CheckName
from robrain.deploy.pki.issuing import folder_of, init, issue
from robrain.deploy.processes.name_claim import claim_robot
from robrain.protocol.access.member import Member, member
from robrain.protocol.clock import LiveClock
from robrain.protocol.extras import MissingPackage
from robrain.protocol.messages.robots.plugin_messages import ROBOT_WHO, ProcessInfo
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from robrain.sim.firmware.line_plug import SerialPlug
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


def robot(tmp_path: Path, text: str) -> doctor.RobotFound:
    path = tmp_path / "r1.toml"
    path.write_text(text)
    found, said = doctor.check_robot_file(path)
    assert found is not None, said
    return found


def wrong(check: team_checks.Check, name: CheckName, *parts: str) -> None:
    """It is wrong, says so in these words, and what to do."""
    assert (check.name, check.ok) == (name, False)
    assert check.remedy
    for part in parts:
        assert part in check.sentence


def test_router_that_answers(endpoints) -> None:
    assert doctor.check_router(endpoints).ok


def test_router_that_cannot_be_reached(free) -> None:
    wrong(doctor.check_router([f"tcp/127.0.0.1:{free}"]), CheckName.ROUTER, f"nobody listens at tcp/127.0.0.1:{free}")


@pytest.mark.slow
def test_something_that_is_no_router(taken) -> None:
    wrong(doctor.check_router([f"tcp/127.0.0.1:{taken}"]), CheckName.ROUTER, "admits no client")


def test_key_space_that_is_open(endpoints) -> None:
    assert team_checks.check_key_space(endpoints, TEAM, "r1").ok


@pytest.mark.slow
def test_key_space_that_the_router_denies(monkeypatch) -> None:
    monkeypatch.setattr(team_checks, "ASK_S", 0.5)
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
        found = team_checks.check_key_space(listening_at(router)[:1], TEAM, "r1")
    wrong(found, CheckName.KEY_SPACE, "r1 of team default", "access rules")


@pytest.mark.parametrize(
    ("skews_s", "words"),
    [
        ([-30.2, -30.05], "this machine's clock is 30.1 s ahead of the team's"),
        ([1.9, 2.0], "this machine's clock is 2.0 s behind the team's"),
    ],
)
def test_clock_that_is_wrong(skews_s: list[float], words: str) -> None:
    wrong(team_checks.check_clock(skews_s), CheckName.CLOCK, words)


def test_clock_that_agrees_though_one_message_was_late() -> None:
    assert team_checks.check_clock([-0.01, -1.8]).ok
    assert team_checks.check_clock([]).ok is None


def test_robots_say_who_they_are_and_which_version_they_have(hub, endpoints) -> None:
    with closing(open_session(connect=endpoints)) as session, claim_robot(session, TEAM, "r5") as claim:
        assert claim.acquire(lambda _: None, lambda: False)
        found = until(lambda: team_checks.members(hub, TEAM))
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
        found = until(lambda: len(them := team_checks.holders(hub, TEAM, "r6")) == 2 and them)
        said = team_checks.check_name_free("r6", found)
        for wire in wires:
            wire.close()
    wrong(said, CheckName.NAME, "2 processes say that they are r6: process 0 on host0")


def test_name_that_another_machine_has_and_the_robots_own(tmp_path) -> None:
    (tmp_path / "7").mkdir()
    info = ProcessInfo("here", 7, "zid")
    assert team_checks.check_name_free("r1", [], "here", tmp_path).ok
    assert team_checks.check_name_free("r1", [info], "here", tmp_path).ok
    wrong(
        team_checks.check_name_free("r1", [info], "there", tmp_path), CheckName.NAME, "another machine has the name r1"
    )


def test_port_that_is_free_or_has_the_router_itself(free, endpoints) -> None:
    assert doctor.check_port("the hub", f"tcp/127.0.0.1:{free}").ok
    assert doctor.check_port("the hub", endpoints[0]).sentence == f"the hub is at {endpoints[0]} already"


def test_can_interface_that_is_absent_down_or_up(tmp_path) -> None:
    found = robot(tmp_path, CAN)
    [absent] = doctor.check_can(found, tmp_path)
    wrong(absent, CheckName.CAN, "there is no CAN interface can7 (needed by mocdevice)")
    (tmp_path / "can7").mkdir()
    (tmp_path / "can7" / "flags").write_text("0x80\n")
    [down] = doctor.check_can(found, tmp_path)
    wrong(down, CheckName.CAN, "can7 (needed by mocdevice) is down")
    (tmp_path / "can7" / "flags").write_text("0x81\n")
    assert doctor.check_can(found, tmp_path)[0].ok


def test_extra_that_is_not_installed(tmp_path) -> None:
    found = robot(tmp_path, '[robot]\nname = "r1"\nload = ["planner", "driver"]\n')

    def import_plugin(manifest) -> None:
        if manifest.name == "planner":
            raise PackageMissing(manifest.path, manifest.module_name, MissingPackage("scipy", "navigation"))

    said = doctor.check_extras(found, import_plugin)
    wrong(said, CheckName.EXTRA, "planner need robrain[navigation]")
    assert said.remedy == "pip install 'robrain[navigation]'"
    assert doctor.check_extras(found).ok


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
    found, check = doctor.check_robot_file(path)
    assert found is None
    wrong(check, CheckName.FILE, said)


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
    wrong(doctor.check_devices(found, tmp_path)[0], CheckName.DEVICE, f"{plugin} cannot start", words)


def test_devices_are_opened_and_closed_again(tmp_path) -> None:
    plug = SerialPlug(tmp_path / "base")
    text = '[robot]\nname = "r1"\nload = ["mocdevice"]\n[robot.roles]\nmocdevice = "serial_base"\n'
    found = robot(tmp_path, f'{text}[parameters.mocdevice]\nport = "{plug.path}"\n')
    (check,) = doctor.check_devices(found, tmp_path)
    assert check == team_checks.Check(CheckName.DEVICE, True, "devices that open what their parameters name: mocdevice")
    plug.pull_out()


ROBOT = '[robot]\nname = "r1"\nload = ["mocdevice"]\n'
TEAM_FILE = """
[team]
scenario = "{scenario}"
port = {port}
[[hosts]]
name = "base"
address = "127.0.0.1"
parts = ["hub", "arena", "coordinator", "r1"]
"""


@pytest.fixture
def robot_file(tmp_path) -> Path:
    path = tmp_path / "r1.toml"
    path.write_text(ROBOT)
    return path


def team_file(tmp_path: Path, port: int, scenario: str = "arena_small", parts: str = "") -> Path:
    path = tmp_path / "team.toml"
    path.write_text(TEAM_FILE.format(port=port, scenario=scenario).replace('"r1"', parts or '"r1"'))
    return path


@pytest.mark.slow
def test_robot_that_may_join_is_told_so(capsys, endpoints, robot_file, monkeypatch) -> None:
    monkeypatch.setattr(team_checks, "LISTEN_S", 0.05)
    assert doctor.doctor_command(robot_file, None, endpoints[0], None, as_json=True)
    told = json.loads(capsys.readouterr().out)
    names = {check["name"] for check in told}
    assert {"file", "extra", "map", "router", "key_space", "clock", "version", "name"} <= names
    assert all(set(check) == {"name", "ok", "sentence", "remedy"} for check in told)
    assert all(check["ok"] is not False for check in told)


def test_machine_that_may_start_its_parts(tmp_path, free) -> None:
    checks = doctor.examine_host(team_file(tmp_path, free), None)
    assert [check.name for check in checks] == ["file", "address", "map", "port"]
    assert all(check.ok for check in checks)


NOW = datetime.now(UTC)
R1, R2 = member("robot", "blue", "r1"), member("robot", "blue", "r2")
TLS = ["tls/127.0.0.1:1"]


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    folder = tmp_path / "pki"
    init(folder, "blue", NOW)
    for one in (R1, R2):
        issue(folder, one, NOW)
    return folder


def look(pki: Path, wanted: Member | None = R1, now: datetime = NOW) -> team_checks.Check:
    return doctor.check_certificate(doctor.OwnCertificate(wanted, folder_of(pki, R1)), now)


def test_certificate_of_another_robot(pki: Path) -> None:
    found = look(pki, R2)
    wrong(found, CheckName.CERTIFICATE, "expected the certificate of robot:blue:r2, got that of robot:blue:r1")
    assert "pki issue robot r2" in found.remedy


def test_no_certificate_is_wrong_where_one_is_asked_for_and_nothing_elsewhere() -> None:
    wanted = [doctor.OwnCertificate(R1, None)]
    (found,) = doctor.check_certificates(wanted, TLS)
    assert found.sentence == "the router asks for a certificate, and none is given"
    assert doctor.check_certificates(wanted, ["tcp/127.0.0.1:1"]) == []


def test_each_part_of_a_machine_is_looked_at(pki: Path, tmp_path: Path) -> None:
    path = tmp_path / "team.toml"
    path.write_text(
        '[team]\nname = "blue"\nscenario = "arena_small"\npki = "pki"\nport = 1\n'
        '[[hosts]]\nname = "one"\naddress = "127.0.0.1"\nparts = ["r1", "dashboard"]\n'
        '[[hosts]]\nname = "two"\naddress = "127.0.0.1"\nparts = ["hub"]\n'
    )
    found = [check for check in doctor.examine_host(path, "one") if check.name is CheckName.CERTIFICATE]
    assert [check.ok for check in found] == [True, False, False]
    assert "dashboard.page" in found[1].sentence
    assert "operator.up" in found[2].sentence
