"""A team file, the parts that a machine starts by it, and their certificates."""

import os
import shutil
import socket
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest

from robrain.deploy.errors import PkiError, UsageError
from robrain.deploy.pki.issuing import CA_KEY, DAYS, MEMBERS_FILE, read_members, renew, revoke
from robrain.deploy.processes.arena_process import resumed, robot_file_of, started_again, write_resume
from robrain.deploy.supervision.credentials import Credentials
from robrain.deploy.supervision.site import Printed, Site
from robrain.deploy.supervision.team_file import is_team_file, read_team_file
from robrain.deploy.supervision.up import choose_endpoint
from robrain.protocol.access.identity import KEY, TLS_VARIABLE, read_identity
from robrain.protocol.messages.team.arena_messages import ArenaTruth, RobotTruth
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.hub import HUB_VARIABLE
from robrain.sim.scenarios.scenario import Scenario

GOOD = """
[team]
name = "blue"
scenario = "depot"
port = 7000

[[hosts]]
name = "base"
address = "10.0.0.5"
parts = ["hub", "arena", "coordinator", "stand-by", "recorder", "dashboard"]

[[hosts]]
name = "cart"
address = "cart.local"
parts = ["r1", "r2"]
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "team.toml"
    path.write_text(text)
    return path


def test_hosts_and_the_hubs_endpoint_are_read(tmp_path) -> None:
    path = written(tmp_path, GOOD)
    found = read_team_file(path)
    assert found.endpoint == "tcp/10.0.0.5:7000"
    assert found.host(path, "cart").robots == ["r1", "r2"]
    assert found.host(path, "base").robots == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("10.0.0.5", "10.0.0.5:7447", "hosts[0]: address: expected an IP address or a host name, got '10.0.0.5:7447'"),
        ('"r1", "r2"', '"r1", "r1"', "hosts[1]: parts: expected r1 once"),
        ('"r1", "r2"', "", "hosts[1]: parts: expected at least one of hub, arena,"),
        ('"r1", "r2"', '"r1", "arena"', "hosts: expected arena on one host, got base, cart"),
        ('"r1", "r2"', '"r/1"', "hosts[1]: "),
        ('"cart"', '"base"', "hosts: expected each name once, got base 2 times"),
        ('"hub", ', "", "hosts: expected one with the part hub"),
        ('scenario = "depot"', "", "team.scenario: expected a scenario for the part arena"),
        ("7000", "70000", "team: expected port"),
        ("7000", '"7000"', "team.port: Expected `int`, got `str`"),
        ("port = 7000", 'rules = "x.toml"', "team: rules: expected no such file, because the scenario has its own"),
        ("port = 7000", "prot = 7000", "team: unknown key `prot` (did you mean `port`?)"),
        ("[[hosts]]", "[[hosts", "is not TOML"),
        ('[team]\n', '[robots]\nr9 = "r9.toml"\n[team]\n', "robots.r9: expected a file"),
        ("[[hosts]]", "[[computers]]", "unknown key `computers`"),
    ],
)  # fmt: skip
def test_wrong_file_is_told_by_file_key_and_what_was_expected(tmp_path, old: str, new: str, said: str) -> None:
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(UsageError) as error:
        read_team_file(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("name", "said"), [(None, "expected --host with one of base, cart"), ("van", "--host van: expected one of base, ")]
)
def test_host_that_is_not_there_is_told_with_those_that_are(tmp_path, name: str | None, said: str) -> None:
    path = written(tmp_path, GOOD)
    with pytest.raises(UsageError, match=said):
        read_team_file(path).host(path, name)


def test_scenario_file_is_no_team_file(tmp_path) -> None:
    assert is_team_file(written(tmp_path, GOOD))
    assert not is_team_file(written(tmp_path, '[scenario]\nname = "x"\n'))
    assert not is_team_file(tmp_path / "none.toml")
    assert not is_team_file(written(tmp_path, "= ="))


@pytest.fixture
def site(tmp_path) -> Site:
    return Site(tmp_path, "tcp/127.0.0.1:1", "blue", SimpleNamespace(), Printed(0))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def world():
    return Scenario.builtin("arena_small").replace(robots=2).world()


def test_two_coordinators_are_candidates_with_journals_of_their_own(site) -> None:
    parts = ["coordinator", "stand-by", "r1"]
    first, second = site.coordinators(Path("runs/a.journal"), [], parts, ["r1", "r2", "r3"])
    for part, journal in ((first, "runs/a.journal"), (second, "runs/a-stand-by.journal")):
        for start in (1, 2):
            words = part.arguments(start)
            assert words[words.index("--witnesses") + 1] == "r1,r2,r3"
            assert words[words.index("--journal") + 1] == journal
    [alone] = site.coordinators(Path("j"), [], ["coordinator"], [])
    assert "--witnesses" not in alone.arguments(1)


def test_recorder_that_comes_back_writes_another_file(site) -> None:
    part = site.recorder(Path("runs/live.mcap"), None)
    assert part.arguments(1)[2] == "runs/live.mcap"
    assert part.arguments(3)[2] == "runs/live_again_3.mcap"


def test_dashboard_that_comes_back_keeps_its_port(site) -> None:
    part = site.dashboard()
    assert part.arguments(1)[-1] == "0"
    site.printed.read("dashboard", "dashboard: http://127.0.0.1:8123")
    assert part.arguments(2)[-1] == "8123"


def test_hub_that_comes_back_listens_where_the_first_did() -> None:
    printed = Printed(None)
    printed.read("hub", "hub: tcp/127.0.0.1:4000, tcp/[::1]:4000")
    printed.read("hub", "hub: tcp/127.0.0.1:5000")
    assert printed.endpoint == "tcp/127.0.0.1:4000"


def test_robots_stand_where_they_stood_when_the_arena_comes_back(tmp_path, world) -> None:
    pose = Pose2D(2.0, 1.0, 0.5)
    truth = ArenaTruth(
        sim_time_s=9.0, robots=[RobotTruth(robot="r2", pose=pose, collisions=0, distance_m=1.0, energy_j=2.0)]
    )
    again = resumed(world, write_resume(tmp_path / "resume.json", truth))
    assert [robot.start for robot in again.robots] == [world.robots[0].start, pose]


def test_agent_that_comes_back_begins_where_its_robot_last_said_it_was(world) -> None:
    robot_file = robot_file_of(world, world.robots[1], team="blue", connect="tcp/127.0.0.1:1")
    again = started_again(robot_file, Pose2D(2.0, 1.0, 0.5)).parameters["localisation"]
    assert (again["x_m"], again["y_m"], again["yaw_rad"], again["start_known"]) == (2.0, 1.0, 0.5, True)
    assert again["wall_slack_cells"] == robot_file.parameters["localisation"]["wall_slack_cells"]
    assert started_again(robot_file, None).parameters["localisation"]["start_known"] is False


NOW = datetime.now(UTC)
PARTS = ("hub", "arena", "coordinator", "stand-by", "recorder", "dashboard", "r1")
SOON = NOW + timedelta(days=DAYS * 0.7)
"""When the certificates made at `NOW` soon end."""


@pytest.fixture
def made(tmp_path: Path) -> Credentials:
    credentials = Credentials(tmp_path / "pki", "blue")
    credentials.prepare(PARTS, NOW, hosts=["10.0.0.5"])
    return credentials


def serials(credentials: Credentials) -> dict[str, str]:
    return {str(one.member): one.serial for one in read_members(credentials.pki / MEMBERS_FILE).members}


@pytest.mark.parametrize(("hub", "wanted"), [("", "tls/127.0.0.1:0"), ("tcp/127.0.0.1:", ""), ("tls/127.0.0.1:", "")])
def test_secured_team_listens_at_the_port_of_the_hub_variable(
    monkeypatch: pytest.MonkeyPatch, hub: str, wanted: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        monkeypatch.setenv(HUB_VARIABLE, hub and f"{hub}{port}")
        taken = f"tls/127.0.0.1:{port}"
        assert choose_endpoint(None, is_secured=True) == ("tls/127.0.0.1:0", taken if hub else "")
    assert choose_endpoint(None, is_secured=True) == (wanted or taken, "")


def test_each_part_gets_a_certificate_of_its_role_and_a_key_that_nobody_else_can_read(made: Credentials) -> None:
    shown = {part: str(read_identity(made.folder(part)).member) for part in PARTS}
    assert shown == {
        "hub": "router:site", "arena": "arena:sim", "coordinator": "coordinator:hq", "stand-by": "coordinator:standby",
        "recorder": "recorder:recorder", "dashboard": "dashboard:page", "r1": "robot:r1",
    }  # fmt: skip
    assert str(read_identity(made.operator).member) == "operator:up"
    for folder in (*map(made.folder, PARTS), made.operator):
        assert stat.S_IMODE((folder / KEY).stat().st_mode) == 0o600
    (router,) = (one for one in read_members(made.pki / MEMBERS_FILE).members if one.role == "router")
    assert "10.0.0.5" in router.hosts


def test_certificates_that_are_there_stay_and_those_of_new_parts_are_added(made: Credentials) -> None:
    before = serials(made)
    made.prepare((*PARTS, "r2"), NOW)
    after = serials(made)
    assert after.pop("robot:r2")
    assert after == before


@pytest.mark.slow
def test_certificates_that_soon_end_are_renewed_at_the_start_and_while_the_team_runs(made: Credentials) -> None:
    before = serials(made)
    assert made.renew(PARTS, NOW) == []
    assert "robot:r1" in made.renew(PARTS, SOON)
    assert not before.items() & serials(made).items()
    before = serials(made)
    made.prepare(PARTS, SOON + timedelta(days=DAYS))
    assert not before.items() & serials(made).items()


@pytest.mark.parametrize("before", [None, "/etc/robrain/operator.ann"])
def test_this_process_is_an_operator_for_as_long_as_the_team_runs(made: Credentials, before, monkeypatch) -> None:
    monkeypatch.delenv(TLS_VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(TLS_VARIABLE, before)
    with made.as_operator():
        assert os.environ[TLS_VARIABLE] == str(made.operator)
    assert os.environ.get(TLS_VARIABLE) == before


def test_a_machine_without_the_key_of_the_ca_needs_the_folders_of_its_parts(made: Credentials, tmp_path: Path) -> None:
    away = Credentials(tmp_path / "away", "blue")
    for part in ("r1", "dashboard"):
        shutil.copytree(made.folder(part), away.pki / "members" / made.folder(part).name)
    shutil.copytree(made.operator, away.pki / "members" / made.operator.name)
    away.prepare(["r1", "dashboard"], NOW)
    assert away.folder("r1") == away.pki / "members" / "robot.r1"
    assert away.renew(["r1"], SOON) == []
    with pytest.raises(PkiError) as caught:
        away.prepare(["r1", "r2"], NOW)
    where = away.pki / "members" / "robot.r2" / "certificate.pem"
    assert str(caught.value) == (
        f"{where}: no such file, and no {CA_KEY} in {away.pki} to make it: "
        "`robrain pki issue robot r2` on the machine of the CA, then copy the folder here"
    )


def test_a_revoked_part_is_not_started(made: Credentials) -> None:
    revoke(made.pki, made.member("r1"))
    assert made.renew(["r1", "dashboard"], SOON) == ["dashboard:page", "operator:up"], "the others go on"
    with pytest.raises(PkiError, match="robot:r1 is revoked"):
        made.prepare(["r1"], NOW)


def test_short_certificates_are_not_renewed_all_the_time(made: Credentials) -> None:
    renew(made.pki, made.member("hub"), NOW, days=1)
    assert "router:site" not in made.renew(["hub"], NOW + timedelta(hours=15))
    assert "router:site" in made.renew(["hub"], NOW + timedelta(hours=17))


def test_a_machine_without_the_router_makes_no_ca_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(PkiError, match=r"no such file, and no ca\.key"):
        Credentials(tmp_path / "pki", "blue").prepare(["r1"], NOW)
    assert not (tmp_path / "pki").exists()


def test_certificates_of_another_team_are_refused_with_the_option_that_names_it(made: Credentials) -> None:
    with pytest.raises(PkiError, match="of team blue, not red; give --team blue"):
        Credentials(made.pki, "red").prepare(PARTS, NOW)
