"""Commands on one machine find its hub, wait for it, and list who else is there."""

import itertools
import json
import re
import signal
import socket
import subprocess
import urllib.request
from collections.abc import Iterator

import psutil
import pytest

from robrain.protocol.wire.session import open_session
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system
WAITS = "yet: waiting for"


@pytest.fixture(scope="module")
def up(tmp_path_factory: pytest.TempPathFactory) -> "Iterator[tuple[Commands, subprocess.Popen[str]]]":
    """`robrain up` with one robot and no endpoint given, and commands on the same machine."""
    found = Commands(tmp_path_factory.mktemp("team"))
    try:
        process = found.start("up", "arena_small", "--robots", "1", "--no-dashboard")
        assert found.line_with(process, "hub: ").split()[1] == found.hub.endpoint
        seen = ""
        while "r1: up" not in seen or "coordinator: up" not in seen:
            seen += found.line_with(process, ": up")
        yield found, process
    finally:
        found.stop_all()


@pytest.fixture(scope="module")
def team(up: "tuple[Commands, subprocess.Popen[str]]") -> Commands:
    return up[0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["status", "--json"], '"robots":["r1"]'),
        (["task", "list", "--all"], "task"),
        (["halt", "--reason", "a test"], "team default: 1 of 1 robots halted"),
        (["resume"], "team default: 1 of 1 robots resumed"),
    ],
)
def test_what_a_team_is_asked_for_goes_to_stdout_without_an_endpoint_given(
    team: Commands, words: list[str], said: str
) -> None:
    done = team.run_until(lambda done: done.returncode == 0 and said in done.stdout, *words)
    assert done.stderr == ""


def test_top_and_doctor_see_the_team_of_this_machine(up: "tuple[Commands, subprocess.Popen[str]]") -> None:
    team, process = up
    parts = {"hub", "arena", "coordinator", "r1"}

    def members() -> dict[str, dict[str, object]] | None:
        done = team.run_here("top", "--json")
        told = {member["name"]: member for member in json.loads(done.stdout)} if done.returncode == 0 else {}
        return told if parts <= set(told) and all("pid" in member for member in told.values()) else None

    found = until(members)
    processes = {child.pid for child in psutil.Process(process.pid).children()}
    assert {found[name]["pid"] for name in parts} <= processes
    assert "states/s" in str(found["r1"]["messages"])
    (team.folder / "r1.toml").write_text('[robot]\nname = "r1"\nload = ["mocdevice"]\n')
    looked = team.run("doctor", "r1.toml", "--json")
    told = {check["name"]: check for check in json.loads(looked.stdout)}
    assert looked.returncode == 0, [check for check in told.values() if check["ok"] is False]
    assert told["name"]["sentence"].startswith("r1 has joined")
    assert told["clock"]["ok"]
    assert told["version"]["ok"]
    assert told["device"]["ok"] is None


def test_metrics_of_a_live_robot_are_scraped(team: Commands) -> None:
    metrics = team.start("metrics", "--port", "0")
    url = team.line_with(metrics, "metrics: of team default at ").rpartition(" at ")[2].strip()
    assert url.startswith("http://127.0.0.1:")

    def scraped() -> str:
        with urllib.request.urlopen(url) as reply:
            return str(reply.read().decode())

    for line in (
        r'robrain_robot_up{robot="r1"} 1.0',
        r'robrain_robot_soc_ratio{robot="r1"} 0\.\d+',
        r'robrain_messages_total{topic="robot_state"} [1-9]',
        r'robrain_plugin_restarts_total{plugin="driver",robot="r1"} \d',
    ):
        until(lambda line=line: re.search(line, scraped()), f"no {line}")


@pytest.mark.parametrize(
    ("words", "missing"),
    [
        (["status"], "nobody of team blue is at tcp/"),
        (["call", "r1", "driver", "pose"], "no robot r1 in team blue"),
        (["halt"], "no robot of team blue is there"),
    ],
)
def test_in_the_wrong_team_those_that_are_there_are_named(team: Commands, words: list[str], missing: str) -> None:
    done = team.run_until(
        lambda done: missing in done.stderr and done.stderr.endswith("; there is team default\n"),
        *words, "--team", "blue",
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")


def test_up_tells_hub_page_and_forwarders_as_lines_of_json_while_it_runs(commands: Commands) -> None:
    hub = open_session(mode="router", listen=[commands.hub.endpoint])
    try:
        words = ["up", "arena_small", "--robots", "1", "--port", "0", "--json"]
        process = commands.start(*words, stderr=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stderr is not None
        lines = map(json.loads, iter(process.stdout.readline, ""))
        told = list(itertools.islice((one for one in lines if one["event"] != "part"), 4))
        first = told[0]
        assert sorted(one["event"] for one in told) == ["dashboard", "hub", "journal", "serial_forwarder"]
        assert first["event"] == "hub"
        assert first["endpoint"] != commands.hub.endpoint
        assert f"{commands.hub.endpoint} is in use" in process.stderr.readline()
        by_event = {one["event"]: one for one in told}
        assert by_event["dashboard"]["url"].startswith("http://127.0.0.1:")
        assert by_event["serial_forwarder"]["robot"] == "r1"
        host, _, port = by_event["serial_forwarder"]["address"].partition(":")
        socket.create_connection((host, int(port)), PATIENCE_S).close()
        children = psutil.Process(process.pid).children(recursive=True)
        assert len(children) >= 5  # a guard, hub, arena, coordinator and an agent
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
        assert not [child for child in children if child.is_running()]
        (result,) = [one for one in map(json.loads, rest.splitlines()) if one["event"] != "part"]
        assert (result["event"], result["ended"]) == ("result", "interrupted")
        assert result["serial_forwarders"] == {"r1": by_event["serial_forwarder"]["address"]}
    finally:
        hub.close()  # type: ignore[no-untyped-call]


def test_agent_coordinator_recorder_and_arena_wait_for_their_hub_and_say_so_once(commands: Commands) -> None:
    (commands.folder / "r1.toml").write_text('[robot]\nname = "r1"\nload = ["counter"]\n')
    waiting = {
        "agent": ("agent: r1 is up", ["agent", "r1.toml"]),
        "coordinator": ("coordinator: of team default", ["coordinator"]),
        "record": ("recording to run.mcap", ["record", "--output", "run.mcap"]),
        "arena": ("arena: arena_small at", ["arena", "arena_small", "--connect", commands.hub.endpoint]),
    }
    started = {who: commands.start(*words) for who, (_, words) in waiting.items()}
    for who, process in started.items():
        assert commands.line_with(process, WAITS).startswith(f"{who}: nobody answers at {commands.hub.endpoint} ")
    hub = open_session(mode="router", listen=[commands.hub.endpoint])
    try:
        for who, (ready, _) in waiting.items():
            process = started[who]
            assert process.stdout is not None
            line = process.stdout.readline()  # the very next line: it did not repeat the message
            assert line.startswith(ready) or "serial forwarder" in line, line
            process.send_signal(signal.SIGINT)
        for process in started.values():
            process.communicate(timeout=PATIENCE_S)
            assert process.returncode == 0
    finally:
        hub.close()  # type: ignore[no-untyped-call]


def test_ctrl_c_ends_an_agent_that_waits_for_its_hub(commands: Commands) -> None:
    (commands.folder / "r1.toml").write_text('[robot]\nname = "r1"\n')
    before = set(commands.folder.iterdir())
    process = commands.start("agent", "r1.toml")
    commands.line_with(process, WAITS)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (0, "")
    assert set(commands.folder.iterdir()) == before
