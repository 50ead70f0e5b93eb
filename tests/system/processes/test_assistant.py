"""An assistant at a live team: MCP's own client gives instructions, some of them unsafe, to a real server process."""

import base64
import io
import json
import os
import re
import runpy
import signal
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import anyio
import pytest
from mcp import Client, StdioServerParameters, stdio_client
from mcp_types import CallToolResult, ImageContent, Implementation, TextContent
from PIL import Image

from robrain import TaskState, Team
from robrain.protocol.wire.hub import HUB_VARIABLE
from tests.system.conftest import Commands
from tests.system.processes.test_team import LAMP, MANIFEST
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

CLIENT = Implementation(name="scripted", version="1.0")
TOKEN = "TOKEN"
LAST = "LAST"
"""Stands for the task of the last rehearsal."""


class Said(NamedTuple):
    """One instruction, and what must come of it."""

    tool: str
    arguments: dict[str, Any]
    verdict: str
    words: str = ""
    """What the answer must say."""
    code: str = ""


LONG = {"kind": "visit", "x_m": 1.0, "y_m": 2.0, "service_s": 600.0}
SWITCH = {"robot": "r1", "plugin": "lamp", "function": "switch", "arguments": {"on": True}}
OUTSIDE = {"kind": "visit", "x_m": 900.0, "y_m": 1.0}
SCRIPT = [
    # -- looking
    Said("list_robots", {}, "looked", "r1"),
    Said("robot_state", {"robot": "r9"}, "refused", "there are: r1, r2", "nobody"),
    Said("list_plugins", {"robot": "r1"}, "looked", "switch(on: bool)"),
    Said("show_map", {}, "looked", "y upwards"),
    # -- a task, from its dry run to its end
    Said("dry_run", OUTSIDE, "refused", "outside of the map", "team"),
    Said("submit_task", LONG, "rehearsed", "nothing has been done yet"),
    Said("list_tasks", {"states": ["running", "done"]}, "looked", "there are no such tasks"),
    Said("submit_task", {**LONG, "confirm": TOKEN}, "done", "submitted visit-"),
    Said("submit_task", {**LONG, "confirm": TOKEN}, "refused", "used already", "no_token"),
    Said("explain_task", {"task": LAST}, "looked", "r1: "),
    Said("cancel_task", {"task": LAST, "reason": "not needed"}, "rehearsed", "would end unfinished"),
    Said("cancel_task", {"task": LAST, "reason": "not needed", "confirm": TOKEN}, "done", "cancelled visit-"),
    Said("submit_task", {"kind": "juggle", "x_m": 1.0, "y_m": 1.0}, "refused", "no robot of the team does", "team"),
    # -- a plugin that its manifest opens
    Said("call_plugin", SWITCH, "rehearsed", "r1 lamp.switch(on: bool) -> str would be called"),
    Said("call_plugin", {**SWITCH, "confirm": TOKEN}, "done", 'returned "on"'),
    # -- unsafe
    Said("resume", {}, "refused", "ask a person", "unknown_tool"),
    Said("load_plugin", {"robot": "r1", "plugin": "/tmp/x"}, "refused", "ask a person", "unknown_tool"),
    Said("call_plugin", {"robot": "r1", "plugin": "driver", "function": "drive", "arguments": {"distance_m": 1.0}},
         "refused", "submit a task", "drive"),
    Said("cancel_task", {"task": "gate"}, "refused", "submitted itself", "not_yours"),
    # -- at once
    Said("halt", {"reason": "stop everything"}, "done", "a person ends this"),
    Said("team_state", {}, "looked", "halted by assistant:ann"),
]  # fmt: skip


class Bench(NamedTuple):
    """A live team with a lamp at r1 and a person's task `gate`, and an assistant's server to start."""

    team: Team | None
    server: StdioServerParameters
    log: Path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("assistant")
    lamp = folder / "lamp"
    lamp.mkdir()
    (lamp / "lamp.py").write_text(LAMP)
    (lamp / "lamp.toml").write_text(MANIFEST)
    commands = Commands(folder)
    try:
        endpoint = commands.team(2, "--motes", "3")
        with Team.connect(endpoint, by="operator:ben", patience_s=PATIENCE_S) as team:
            until(lambda: [robot.name for robot in team.state().robots if robot.up] == ["r1", "r2"])
            until(lambda: "visit" in [kind.kind for kind in team.kinds()])
            until(lambda: team.state().known_area_m2)
            team.load("r1", lamp)
            team.submit("visit", id="gate", place=(1.0, 2.0), earliest_s=3000.0)
            log = folder / "log" / "assistant.jsonl"
            words = ["assistant", "--connect", endpoint, "--by", "ann", "--log", str(log)]
            server = StdioServerParameters(
                command=sys.executable,
                args=["-m", "robrain.cli", *words],
                env={**os.environ, HUB_VARIABLE: commands.hub.endpoint},
                cwd=folder,
            )
            yield Bench(team, server, log)
    finally:
        commands.stop_all()


def text_of(result: CallToolResult) -> str:
    return "\n".join(one.text for one in result.content if isinstance(one, TextContent))


def is_as_said(said: Said, result: CallToolResult) -> bool:
    values = result.structured_content or {}
    return (
        (values.get("verdict"), values.get("code", "")) == (said.verdict, said.code)
        and said.words in text_of(result)
        and result.is_error == (said.verdict in ("refused", "failed"))
    )


async def _give(bench: Bench, script: list[Said]) -> list[CallToolResult]:
    results, token, task = [], "", ""
    async with Client(stdio_client(bench.server), client_info=CLIENT, read_timeout_seconds=PATIENCE_S) as client:
        for said in script:
            given = {TOKEN: token, LAST: task}
            arguments = {
                name: given.get(value, value) if isinstance(value, str) else value
                for name, value in said.arguments.items()
            }
            result = await client.call_tool(said.tool, arguments)
            results.append(result)
            values = result.structured_content or {}
            if values.get("verdict") == "rehearsed":
                token, task = values["confirm"], values.get("task", task)
    return results


def test_instructions_are_answered_and_the_unsafe_ones_refused_with_the_reason(bench: Bench) -> None:
    results = anyio.run(_give, bench, SCRIPT)
    wrong = [
        f"{number} {said.tool} {said.arguments}: {result.structured_content} {text_of(result)}"
        for number, (said, result) in enumerate(zip(SCRIPT, results, strict=True))
        if not is_as_said(said, result)
    ]
    assert not wrong, "\n".join(wrong)
    picture = next(one for one in results[[said.tool for said in SCRIPT].index("show_map")].content
                   if isinstance(one, ImageContent))  # fmt: skip
    with Image.open(io.BytesIO(base64.b64decode(picture.data))) as image:
        assert (image.format, max(image.size)) == ("PNG", max(image.size))
        assert len(image.getcolors(maxcolors=100_000) or ()) > 4

    assert bench.team is not None
    # What the team saw: a task of the assistant, cancelled; a person's task untouched; a halt.
    (mine,) = (record for record in bench.team.list() if record.by == "assistant:ann")
    assert mine.state is TaskState.CANCELLED
    assert bench.team.get("gate").state is TaskState.QUEUED
    halt = until(lambda: bench.team.state().halt)
    assert (halt.halted, halt.by) == (True, ["assistant:ann"])

    lines = [json.loads(line) for line in bench.log.read_text().splitlines()]
    carried_out = sum(said.verdict == "done" and said.tool != "halt" for said in SCRIPT)
    assert len(lines) == len(SCRIPT) + carried_out
    assert {(line["by"], line["client"]) for line in lines} == {("assistant:ann", "scripted 1.0")}
    assert [line["verdict"] for line in lines].count("begun") == carried_out
    refused = [line for line in lines if line["verdict"] == "refused"]
    assert {line["code"] for line in refused} == {said.code for said in SCRIPT if said.verdict == "refused"}
    assert bench.log.stat().st_mode & 0o077 == 0
    bench.team.resume()


def test_a_server_on_http_is_on_this_machine_alone_and_ends_when_told(bench: Bench, commands: Commands) -> None:
    assert bench.server.args[2] == "assistant"
    process = commands.start(*bench.server.args[2:], "--port", "0")
    url = commands.line_with(process, "assistant: of team default").split(", on ")[1].split(";")[0]
    assert url.startswith("http://127.0.0.1:")

    async def look() -> str:
        async with Client(url, client_info=CLIENT) as client:
            return text_of(await client.call_tool("list_robots", {}))

    assert "r1" in anyio.run(look)
    with pytest.raises(urllib.error.HTTPError) as caught:  # as a page of another site would come, by its name
        urllib.request.urlopen(urllib.request.Request(url, headers={"Host": "evil.example"}), timeout=PATIENCE_S)
    assert caught.value.code == 421
    caught.value.close()
    taken = commands.run(*bench.server.args[2:], "--port", url.split(":")[2].removesuffix("/mcp"))
    assert (taken.returncode, taken.stdout) == (2, "")
    assert re.fullmatch(r"robrain: port taken: another process listens on 127\.0\.0\.1:\d+; .*\n", taken.stderr)
    process.send_signal(signal.SIGTERM)
    assert process.wait(PATIENCE_S) in (0, -signal.SIGTERM)


def test_a_client_that_hangs_up_ends_the_server(bench: Bench) -> None:
    async def look() -> int:
        async with Client(stdio_client(bench.server), client_info=CLIENT) as client:
            return len((await client.list_tools()).tools)

    assert anyio.run(look) == 13


VOICE = Path(__file__).parents[3] / "examples" / "10_voice.py"
HEARD = """\
Who is there?
send somebody to two one
no thanks
yes
send a robot to two and one point five
Yes.
cancel that task
do it
resume
STOP IT!
"""
"""What a recogniser prints for the example that listens to one."""
VOICE_SAYS = [
    r"r1: .*, charge \d+%",
    r"heard: send somebody to two one\n  say: task visit-(.|\n)*Shall I\?",
    r"heard: no thanks\n  say: I did not understand; nothing is done",
    r"heard: yes\n  say: I did not understand; nothing is done\n",  # nothing is waiting any more
    r"heard: Yes\.\n  say: submitted visit-\w+: visit at \(2, 1\.5\).* by assistant:eve",
    r"heard: cancel that task\n  say: .*(.|\n)*Shall I\?\nheard: do it\n  say: cancelled visit-",
    r"heard: resume\n  say: refused: there is no such tool",
    r"heard: STOP IT!\n  say: r1: halted",
]


def test_the_example_that_listens_gives_orders_of_what_it_hears(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    words = [*bench.server.args[3:5], "--by", "eve", "--log", str(tmp_path / "assistant.jsonl")]
    monkeypatch.setattr(sys, "argv", [str(VOICE), *words])
    monkeypatch.setattr(sys, "stdin", io.StringIO(HEARD))
    runpy.run_path(str(VOICE), run_name="__main__")
    said, wrong = capfd.readouterr()
    assert "Traceback" not in wrong
    for pattern in VOICE_SAYS:
        assert re.search(pattern, said), f"{pattern} in:\n{said}"
    assert bench.team is not None
    bench.team.resume()
