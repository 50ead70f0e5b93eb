"""Members of a secured team start, are renewed and revoked while it runs, and say what keeps them out."""

import signal
import subprocess
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import click
import pytest
import zenoh
from typer.main import get_command

from robrain.agent.authoring.skeleton import write_skeleton
from robrain.cli import all_commands
from robrain.deploy.pki.issuing import folder_of, init, issue, renew, revoke
from robrain.deploy.pki.router import SecuredRouter
from robrain.deploy.processes.live_process import check_certificate, check_rights
from robrain.protocol.access.identity import TLS_VARIABLE, read_identity
from robrain.protocol.access.member import Member, MemberRole, member
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import NobodyThere, WireError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_LOG_KEPT
from robrain.protocol.messages.team.team_messages import COORDINATOR_HALT
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import CONNECT_VARIABLE
from robrain.protocol.wire.session import listening_at, open_session
from tests.system.conftest import Commands
from tests.system.routers import start_router
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system
TEAM = "blue"
ROUTER, ROBOT = member("router", TEAM, "site"), member("robot", TEAM, "r1")
HQ, ANN = member("coordinator", TEAM, "hq"), member("operator", TEAM, "ann")
MEMBERS = (
    "router site", "coordinator hq", "operator ann", "viewer vic", "arena sim", "recorder rec", "robot r1",
    "dashboard hall",
)  # fmt: skip
ZONES = '[[planning.zones]]\nname = "dock"\nkind = "keep_out"\ncorners_m = [[2, 2], [3, 2], [3, 3]]\n'
RULES = """
[[rules]]
name = "night"
schedule = { rrule = "FREQ=DAILY" }
task = { kind = "visit", place = "dock" }
"""
VISIT = "task add visit --at 16,6.3"
ALLOWED = {
    "status": (0, "r1"),
    "halt r1": (0, "r1: halted"),
    "resume r1": (0, "r1: resumed"),
    "halt": (0, "1 of 1 robots halted"),
    "resume": (0, "1 of 1 robots resumed"),
    "lead": (0, "all robots count"),
    "call r1 home start": (0, "x_m"),
    "remove r1": (2, "r1 is not removed: it is there"),
    "shell r1": (0, ""),
    "log r1": (0, ""),
    "plugin list r1": (0, "counter"),
    "plugin reload r1 counter": (0, "counter: active"),
    "plugin unload r1 counter": (0, "counter: unloaded"),
    "plugin load r1 counter": (0, "counter: active"),
    "task kinds": (0, "visit"),
    f"{VISIT} --dry-run": (0, "would be accepted"),
    f"{VISIT} --id v1": (0, "v1: queued"),
    "task watch v1": (0, "v1: done at r1"),
    "task list": (0, "operator:ann"),
    "task show v1": (0, "v1: done"),
    "task why v1": (0, "done"),
    "task cancel v1": (2, "task v1 has ended already"),
    "task change v1 --priority 2": (2, "v1"),
    "task objective makespan": (0, "makespan"),
    "task charges": (0, "no robot charges"),
    "journal backup": (0, "blue.journal.backups"),
    "robot hold r1 --reason cleaning": (0, "r1: out of service"),
    "robot release r1": (0, "r1: in service"),
    "robot pause r1": (0, "r1: "),
    "robot resume r1": (0, "r1: in service"),
    "robot rename r1 Anna": (0, "r1: called Anna"),
    "robot retire r9": (2, "no such robot is known"),
    "zone list": (0, "the team has no zones"),
    "rule put rules.toml": (0, "night: FREQ=DAILY"),
    "rule list": (0, "night: FREQ=DAILY"),
    "rule remove night": (0, "the team has no rules"),
    "mission list": (0, "no mission was started"),
    "mission start round": (2, "there is no mission round"),
    "mission cancel round-1": (2, "there is no mission round-1"),
    "zone put zones.toml": (0, "dock: keep out"),
    "zone mask dock mask.yaml": (2, "mask.yaml"),
    "zone clear dock --for-s 60": (0, "dock: keep out"),
    "zone open dock": (0, "dock: keep out"),
    "zone remove dock": (0, "the team has no zones"),
    "top --once": (0, "coordinator"),
    "doctor": (0, "the certificate of operator:blue:ann"),
}
"""What an operator may do: each command with its exit status and some text of its answer."""
SERVING = {
    "metrics --port 0": ("operator ann", "metrics: of team blue at http://", 0),
    "foxglove --port 0": ("operator ann", "foxglove: ws://", 0),
    "assistant": ("operator ann", "of team blue as operator:ann", 130),
    "dashboard --port 0": ("dashboard hall", "dashboard: http://", 0),
}
"""Commands that run until Ctrl-C: each with the member that runs it, a line that it prints, and the exit status."""
PARTS = (
    *("router", "arena", "agent", "coordinator", "record", "replay", "bringup", "bench estimates"),
    *("ros2 gateway", "vda5050 vehicle", "vda5050 fleet", "door"),
)
"""Commands that `BlueTeam` starts or other tests run; `bench estimates` sends the same queries as `task`."""
REFUSED = {
    "status": (0, "r1"),
    "plugin list r1": (0, "counter"),
    "task list": (0, "v1"),
    "task why v1": (0, "done"),
    "halt": (2, "viewer:vic may not publish halt: dashboard, operator may"),
    "halt r1": (2, "viewer:vic may not ask host_halt"),
    "resume r1": (2, "viewer:vic may not ask host_resume"),
    "lead": (2, "viewer:vic may not ask coordinator_lead"),
    "remove r1": (2, "viewer:vic may not ask coordinator_remove_robot"),
    "call r1 home start": (2, "viewer:vic may not ask"),
    "plugin reload r1 counter": (2, "viewer:vic may not ask host_reload"),
    VISIT: (2, "viewer:vic may not ask task_submit"),
    "task cancel v1": (2, "viewer:vic may not ask task_cancel"),
    "task objective makespan": (2, "viewer:vic may not ask coordinator_objective"),
    "journal backup": (2, "viewer:vic may not ask coordinator_backup"),
    "rule list": (0, "the team has no rules"),
    "rule remove night": (2, "viewer:vic may not ask coordinator_rules_change"),
    "mission list": (0, "no mission was started"),
    "mission start round": (2, "viewer:vic may not ask mission_start"),
    "mission cancel round-1": (2, "viewer:vic may not ask mission_cancel"),
    "zone list": (0, "the team has no zones"),
    "robot hold r1": (2, "viewer:vic may not ask coordinator_hold_robot"),
    "zone remove dock": (2, "viewer:vic may not ask coordinator_zones_change"),
}


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    init(tmp_path / "pki", TEAM, datetime.now(UTC))
    for who in (ROUTER, ROBOT, HQ, ANN):
        issue(tmp_path / "pki", who, datetime.now(UTC))
    return tmp_path / "pki"


@pytest.fixture
def router(pki: Path) -> Iterator[SecuredRouter]:
    found = SecuredRouter(folder_of(pki, ROUTER), "tls/127.0.0.1:0")
    yield found
    found.close()


def test_router_cuts_nobody_off_when_only_a_certificate_was_renewed(router: SecuredRouter, pki: Path) -> None:
    before = router.session
    renew(pki, ROBOT, datetime.now(UTC))
    assert router.update() == ""
    assert router.session is before
    revoke(pki, ANN)
    assert "2 may connect" in router.update()
    assert router.session is not before


def test_certificate_is_not_left_unused_on_a_plain_endpoint(as_robot: None, pki: Path) -> None:
    with pytest.raises(WireError, match=r"tcp/127\.0\.0\.1:1: expected tls/HOST:PORT, since a certificate"):
        open_session(connect=["tcp/127.0.0.1:1"], wait_s=0.1)
    with pytest.raises(WireError, match="expected tls/HOST:PORT beside a certificate"):
        open_session(connect=["tcp/127.0.0.1:1"], identity=read_identity(folder_of(pki, ROBOT)))
    with pytest.raises(WireError, match="a peer without endpoints: expected tls/HOST:PORT"):
        open_session(mode="peer")


@pytest.fixture
def as_robot(pki: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TLS_VARIABLE, str(folder_of(pki, ROBOT)))


def _wire(pki: Path, router: SecuredRouter, who: Member) -> Endpoint:
    session = open_session(connect=[router.endpoint], identity=read_identity(folder_of(pki, who)))
    return Endpoint(session, TEAM, LiveClock(), Drive.LIVE)


def _close(*wires: Endpoint) -> None:
    for wire in wires:
        wire.close()
        wire.session.close()  # type: ignore[no-untyped-call]


def _answers(wire: Endpoint) -> bool:
    try:
        return wire.ask(COORDINATOR_HALT, timeout_s=1.0) is None
    except NobodyThere:
        return False


def test_new_and_revoked_members_are_heeded_without_a_restart_of_anybody(pki: Path, router: SecuredRouter) -> None:
    hq, ann = _wire(pki, router, HQ), _wire(pki, router, ANN)
    hq.answer(COORDINATOR_HALT, lambda _: None)
    until(lambda: _answers(ann))
    assert router.update() == ""
    bob = member("operator", TEAM, "bob")
    issue(pki, bob, datetime.now(UTC))
    assert "4 may connect" in router.update()
    new = _wire(pki, router, bob)
    until(lambda: _answers(new))
    until(lambda: _answers(ann))
    revoke(pki, bob)
    assert "3 may connect" in router.update()
    until(lambda: _answers(ann))
    assert not _answers(new)
    _close(hq, ann, new)


def test_member_that_the_router_does_not_know_is_told_so(pki: Path, router: SecuredRouter) -> None:
    revoke(pki, ROBOT)
    router.update()
    robot = _wire(pki, router, ROBOT)
    identity = read_identity(folder_of(pki, ROBOT))
    with pytest.raises(
        WireError, match="does not let robot:blue:r1 announce itself, answer, publish: the certificate is revok"
    ):
        check_rights("agent", pytest.fail, robot.session, [router.endpoint], identity)
    _close(robot)


@pytest.mark.parametrize(
    ("role", "team", "name", "says"),
    [
        (MemberRole.ROBOT, TEAM, "r2", "expected the certificate of robot:blue:r2, got that of robot:blue:r1"),
        (MemberRole.ROBOT, "green", "r1", "expected the certificate of robot:green:r1"),
        (MemberRole.COORDINATOR, TEAM, None, "expected the certificate of coordinator:blue:r1"),
    ],
)
def test_certificate_of_another_name_is_refused(
    as_robot: None, role: MemberRole, team: str, name: str | None, says: str
) -> None:
    with pytest.raises(WireError, match=says):
        check_certificate("agent", pytest.fail, ["tls/127.0.0.1:1"], team, role, name)


class BlueTeam:
    """A secured team of real processes with one simulated robot, made by the commands of `secure-a-team.md`."""

    def __init__(self, folder: Path) -> None:
        self.commands = Commands(folder)
        self.pki = folder / "pki"
        assert "CA of team blue" in self.commands.run("pki", "init", "--team", TEAM).stdout
        for words in MEMBERS:
            assert self.commands.run("pki", "issue", *words.split()).returncode == 0
        self.endpoint = start_router(self.commands, self.pki, ROUTER).endpoint
        arena = self.start("arena sim", "arena", "depot", "--robots", "1", "--robot-files", "robots")
        coordinator = self.start("coordinator hq", "coordinator")
        self.recorder = self.start("recorder rec", "record", "--output", "run.mcap")
        self.parts = [arena, coordinator]
        (folder / "zones.toml").write_text(ZONES)
        (folder / "rules.toml").write_text(RULES)
        Commands.line_with(arena, "robots r1")
        robot_file = folder / "robots" / "r1.toml"
        robot_file.write_text(robot_file.read_text() + '\n[zenoh.tls]\nfolder = "../pki/members/robot.r1"\n')
        Commands.line_with(self.commands.start("agent", str(robot_file)), "r1 is up")
        Commands.line_with(coordinator, "of team blue")

    def start(self, who: str, *words: str) -> "subprocess.Popen[str]":
        return self.commands.start(*words, "--team", TEAM, **self._variables(who))

    def ask(self, who: str, *words: str) -> tuple[int, str]:
        ended = self.commands.run_here(*words, "--team", TEAM, **self._variables(who))
        return ended.returncode, ended.stdout + ended.stderr

    def _variables(self, who: str) -> dict[str, str]:
        return {TLS_VARIABLE: str(self.pki / "members" / who.replace(" ", ".")), CONNECT_VARIABLE: self.endpoint}


@pytest.fixture(scope="module")
def blue(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BlueTeam]:
    team = BlueTeam(tmp_path_factory.mktemp("blue"))
    yield team
    for part in team.parts:
        part.send_signal(signal.SIGINT)
        assert part.wait(PATIENCE_S) == 0
    team.commands.stop_all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("who", "role", "answers"), [("operator ann", "operator:ann", ALLOWED), ("viewer vic", "viewer:vic", REFUSED)]
)
def test_every_command_has_its_answer_in_a_secured_team(
    blue: BlueTeam, who: str, role: str, answers: dict[str, tuple[int, str]]
) -> None:
    until(lambda: "mapper" in blue.ask(who, "plugin", "list", "r1")[1], pause_s=0.2)
    wrong = []
    for words, (expected, text) in answers.items():
        status, printed = blue.ask(who, *words.split())
        if status != expected or text not in printed:
            wrong.append(f"{role}: {words}: {status}: {printed}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
@pytest.mark.parametrize(("words", "who", "line", "status"), [(words, *each) for words, each in SERVING.items()])
def test_commands_that_serve_start_in_a_secured_team(
    blue: BlueTeam, words: str, who: str, line: str, status: int
) -> None:
    process = blue.start(who, *words.split())
    Commands.line_with(process, line)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE_S) == status


def test_every_command_that_connects_is_tried_in_a_secured_team() -> None:
    def commands(group: click.Command, *words: str) -> Iterator[str]:
        for name, command in getattr(group, "commands", {}).items():
            yield from commands(command, *words, name)
        if any(option.name == "connect" for option in group.params):
            yield " ".join(words)

    tried = [*ALLOWED, *SERVING, *PARTS]
    assert not [
        name
        for name in commands(get_command(all_commands()))
        if not any(f"{each} ".startswith(f"{name} ") for each in tried)
    ]


def test_configuration_for_zenohd_makes_a_router_of_the_same_rules(pki: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read by Zenoh's own parser, and run by it in the router's folder, as `zenohd -c` does."""
    monkeypatch.chdir(folder_of(pki, ROUTER))
    text = Path("zenohd.json5").read_text().replace("127.0.0.1:7447", "127.0.0.1:0")
    config = zenoh.Config.from_json5(text)
    config.insert_json5("adminspace/enabled", "true")  # for the port that it got
    with closing(zenoh.open(config)) as router:
        endpoint = listening_at(router)[0]
        hq, ann = (open_session(connect=[endpoint], identity=read_identity(folder_of(pki, who))) for who in (HQ, ANN))
        wires = [Endpoint(session, TEAM, LiveClock(), Drive.LIVE) for session in (hq, ann)]
        wires[0].answer(COORDINATOR_HALT, lambda _: None)
        until(lambda: _answers(wires[1]))
        heard = []
        with hq.declare_subscriber(f"robrain/{TEAM}/robot/r1/state", heard.append):
            until(lambda: ann.put(f"robrain/{TEAM}/robot/r1/state", b"{}") or True)
            assert _answers(wires[1])
            assert heard == []
        _close(*wires)


def test_plugin_in_a_process_of_its_own_connects_with_its_robots_certificate(
    commands: Commands, pki: Path, router: SecuredRouter
) -> None:
    folder = commands.folder
    source, manifest, _ = write_skeleton("tool", "device", folder / "plugins")
    source.write_text(source.read_text().replace("return 21.5", 'print("measured")\n        return 21.5'))
    manifest.write_text(manifest.read_text().replace("[tag]", '[tag]\nisolation = "process"'))
    (folder / "r1.toml").write_text(
        f'[robot]\nname = "r1"\nteam = "{TEAM}"\nplaces = ["plugins"]\nload = ["tool", "command"]\n'
        f'[zenoh]\nconnect = ["{router.endpoint}"]\n[zenoh.tls]\nfolder = "{folder_of(pki, ROBOT)}"\n'
    )
    commands.line_with(commands.start("agent", "r1.toml"), "r1 is up with 2 plugins")
    ann = _wire(pki, router, ANN)
    assert ann.ask(ROBOT_CALL, robot="r1", plugin="tool", function="read") == b"21.5"
    logged = [(record.source, record.text) for record in ann.ask(ROBOT_LOG_KEPT, robot="r1")]
    assert ("tool", "measured") in logged
    _close(ann)
