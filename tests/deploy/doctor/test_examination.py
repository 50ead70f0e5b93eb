"""`robrain doctor` as a whole: what is looked at for a robot, for a machine of a team file, and what is printed."""

import json
import socket
from pathlib import Path

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.machine import doctor
from robrain.deploy.machine.doctor import (
    CheckName,
    JoinRequest,
    doctor_command,
    examine_host,
    examine_robot,
    examine_team,
)
from robrain.protocol.wire.session import listening_at, open_session

ROBOT = '[robot]\nname = "r1"\nload = ["mocdevice"]\n'
TEAM = """
[team]
scenario = "{scenario}"
port = {port}
[[hosts]]
name = "base"
address = "127.0.0.1"
parts = ["hub", "arena", "coordinator", "r1"]
"""


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch) -> None:
    monkeypatch.setattr("robrain.deploy.machine.doctor.LISTEN_S", 0.05)


@pytest.fixture
def hub():
    session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    yield listening_at(session)[0]
    session.close()


@pytest.fixture
def free() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.fixture
def robot_file(tmp_path) -> Path:
    path = tmp_path / "r1.toml"
    path.write_text(ROBOT)
    return path


def team_file(tmp_path: Path, port: int, scenario: str = "arena_small", parts: str = "") -> Path:
    path = tmp_path / "team.toml"
    path.write_text(TEAM.format(port=port, scenario=scenario).replace('"r1"', parts or '"r1"'))
    return path


@pytest.mark.slow
def test_robot_that_may_join_is_told_so(capsys, hub, robot_file) -> None:
    assert doctor_command(robot_file, None, hub, None, as_json=True)
    told = json.loads(capsys.readouterr().out)
    names = {check["name"] for check in told}
    assert {"file", "extra", "map", "router", "key_space", "clock", "version", "name"} <= names
    assert all(set(check) == {"name", "ok", "sentence", "remedy"} for check in told)
    assert all(check["ok"] is not False for check in told)


@pytest.mark.slow
def test_robot_whose_router_is_away_is_told_in_words(capsys, free, robot_file) -> None:
    assert not doctor_command(robot_file, None, f"tcp/127.0.0.1:{free}", None, as_json=False)
    said = capsys.readouterr().out
    assert f"WRONG   router: nobody listens at tcp/127.0.0.1:{free}\n          start `robrain up`" in said
    assert "ok      file: " in said


def test_machine_that_may_start_its_parts(tmp_path, free) -> None:
    checks = examine_host(team_file(tmp_path, free), None)
    assert [(check.name, check.ok) for check in checks] == [
        (CheckName.FILE, True), (CheckName.ADDRESS, True), (CheckName.MAP, True), (CheckName.PORT, True),
    ]  # fmt: skip


def test_map_that_is_missing(tmp_path, free) -> None:
    (tmp_path / "mine.toml").write_text('[scenario]\nname = "mine"\n[map]\nfile = "gone.yaml"\n')
    checks = examine_host(team_file(tmp_path, free, "mine.toml"), None)
    [wrong] = [check for check in checks if check.ok is False]
    assert wrong.name is CheckName.MAP
    assert "gone.yaml" in wrong.sentence


def test_robot_that_the_scenario_does_not_have(tmp_path, free) -> None:
    checks = examine_host(team_file(tmp_path, free, parts='"r99"'), None)
    [wrong] = [check for check in checks if check.ok is False]
    assert wrong.sentence.startswith("the scenario arena_small has no robot r99; it has r1")


def test_scenario_without_the_simulator_names_the_extra(tmp_path, free, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'pymunk'", name="pymunk")

    monkeypatch.setattr("robrain.deploy.command_line.scenario_choice.choose_scenario", refuse)
    checks = examine_host(team_file(tmp_path, free), None)
    [wrong] = [check for check in checks if check.ok is False]
    assert (wrong.name, wrong.remedy) == (CheckName.EXTRA, "pip install 'robrain[sim]'")


@pytest.mark.slow
def test_hub_whose_port_another_program_has(tmp_path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        checks = examine_host(team_file(tmp_path, server.getsockname()[1]), None)
    [wrong] = [check for check in checks if check.ok is False]
    assert wrong.name is CheckName.PORT


def test_wrong_team_file_is_one_check(tmp_path) -> None:
    path = tmp_path / "team.toml"
    path.write_text('[[hosts]]\nname = "a"\n')
    [wrong] = examine_host(path, None)
    assert (wrong.name, wrong.ok) == (CheckName.FILE, False)


def test_router_that_goes_while_it_is_looked_at_is_told(hub, monkeypatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise doctor.UsageError("gone")

    monkeypatch.setattr(doctor, "check_key_space", refuse)
    checks = examine_team(JoinRequest([hub], "default", ["r1"]))
    assert (checks[-1].name, checks[-1].ok, checks[-1].sentence) == (CheckName.ROUTER, False, "gone")


def test_robot_that_is_its_own_router_needs_no_other(tmp_path, free) -> None:
    path = tmp_path / "r1.toml"
    path.write_text(f'{ROBOT}[zenoh]\nlisten = ["tcp/127.0.0.1:{free}"]\n')
    assert CheckName.ROUTER not in [check.name for check in examine_robot(path, None, None)]


def test_options_that_do_not_fit_the_file(tmp_path, robot_file, free) -> None:
    with pytest.raises(UsageError, match="expected a team file"):
        doctor_command(robot_file, "base", None, None, as_json=False)
    with pytest.raises(UsageError, match="says that, not the command line"):
        doctor_command(team_file(tmp_path, free), None, "tcp/127.0.0.1:1", None, as_json=False)
