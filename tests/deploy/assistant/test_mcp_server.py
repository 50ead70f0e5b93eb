"""The assistant's MCP server, with MCP's own client in the same process."""

import threading
from collections.abc import Awaitable, Callable

import anyio
import pytest
from jsonschema import Draft202012Validator
from mcp import Client
from mcp_types import CallToolResult, Implementation

from robrain.deploy.assistant.arguments import (
    Arguments,
    CallVerdict,
    HaltRobots,
    OfTask,
    SubmitTask,
    ToolAnswer,
    answer,
)
from robrain.deploy.assistant.assistant import Assistant, Tool, ToolCall
from robrain.deploy.assistant.mcp_server import WAITING_MAX, McpServer
from robrain.deploy.assistant.policy import Order

Script = Callable[[Client], Awaitable[None]]


class FakeAssistant(Assistant):
    """Answers when it may, and keeps what it was asked."""

    def __init__(self) -> None:
        self.calls: list[ToolCall] = []
        self.go_on = threading.Event()
        self.hidden = ""

        def look(_: Arguments) -> ToolAnswer:
            return answer(CallVerdict.READ, ["seen"])

        self.tools = {
            "look": Tool("look", "Look.", OfTask, read=look),
            Order.SUBMIT: Tool(Order.SUBMIT, "Submit.", SubmitTask),
            Order.HALT: Tool(Order.HALT, "Halt.", HaltRobots),
        }

    def may(self, tool: str) -> bool:
        return tool != self.hidden

    def answer(self, call: ToolCall) -> ToolAnswer:
        self.calls.append(call)
        if call.tool == "slow":
            assert self.go_on.wait(30.0)
        if call.tool == "picture":
            return ToolAnswer(CallVerdict.READ, "here", {}, b"\x89PNG")
        return answer(CallVerdict.REFUSED if call.tool == "bad" else CallVerdict.READ, ["words"], code="")


@pytest.fixture
def fake() -> FakeAssistant:
    return FakeAssistant()


def run(fake: FakeAssistant, script: Script, mode: str = "legacy") -> None:
    async def connected() -> None:
        client_info = Implementation(name="scri\npted", version="1.0")
        async with Client(McpServer(fake).server, client_info=client_info, mode=mode) as client:
            await script(client)

    anyio.run(connected)


def test_tools_are_told_with_their_schemas_and_what_they_may_do(fake: FakeAssistant) -> None:
    async def script(client: Client) -> None:
        tools = {tool.name: tool for tool in (await client.list_tools()).tools}
        assert set(tools) == {"look", "submit_task", "halt"}
        for tool in tools.values():
            Draft202012Validator.check_schema(tool.input_schema)
            assert tool.input_schema["type"] == "object"
            assert tool.input_schema["additionalProperties"] is False
        valid = Draft202012Validator(tools["submit_task"].input_schema)
        assert valid.is_valid({"kind": "visit", "x_m": 1, "y_m": 2})
        assert not valid.is_valid({"kind": "visit", "x_m": 1, "y_m": 2, "priority": 2})
        hints = {name: tool.annotations for name, tool in tools.items()}
        assert hints["look"] is not None
        assert hints["look"].read_only_hint
        assert hints["submit_task"] is not None
        assert hints["submit_task"].destructive_hint

    run(fake, script)


@pytest.mark.parametrize("mode", ["legacy", "auto"])
def test_the_client_is_known_by_the_name_that_it_gives_of_itself(fake: FakeAssistant, mode: str) -> None:
    async def script(client: Client) -> None:
        await client.call_tool("look", {"task": "t"})

    run(fake, script, mode)
    assert fake.calls == [ToolCall("scri\\npted 1.0", "look", {"task": "t"})]


def test_too_many_calls_at_a_time_are_refused_and_a_halt_is_not_among_them(fake: FakeAssistant) -> None:
    results: list[CallToolResult] = []

    async def script(client: Client) -> None:
        async def ask() -> None:
            results.append(await client.call_tool("slow", {}))

        async with anyio.create_task_group() as group:
            for _ in range(WAITING_MAX + 3):
                group.start_soon(ask)
            while len(results) < 3:
                await anyio.sleep(0.01)
            assert not (await client.call_tool("halt", {})).is_error  # while the others wait
            fake.go_on.set()

    run(fake, script)
    refused = [one for one in results if one.is_error]
    assert [one.structured_content for one in refused] == [{"code": "busy", "verdict": "refused"}] * 3
    assert len(fake.calls) == WAITING_MAX + 1
