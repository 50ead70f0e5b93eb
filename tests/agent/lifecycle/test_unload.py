"""Unloading plugins from a robot that runs."""

import pytest

from robrain.agent.errors import PluginInUse, PluginUnloaded
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import UnloadRequest
from robrain.protocol.table.host_queries import HOST_UNLOAD
from robrain.protocol.table.topics import ROBOT_CALL

STACK = """
    DIARY = []

    class LowInterface(Protocol):
        def ping(self) -> str: ...

    class Ending:
        def deactivate(self): DIARY.append(self.env.plugin)

    class Low(Ending, Device):
        interface = LowInterface
        @external
        def ping(self) -> str: return "pong"

    class Middle(Ending, Unit):
        interface = LowInterface
        def activate(self): self.low = self.env.use("low", LowInterface)
        @external
        def ping(self) -> str: return self.low.ping()

    class Stubborn(Middle):
        def deactivate(self): raise RuntimeError("never")

    class Top(Ending, Skill):
        def activate(self): self.middle = self.env.use("middle", LowInterface)
"""


@pytest.fixture
def stack(bench):
    bench.code("stack", STACK)
    bench.manifest("low", "stack:Low", visibility=["*", "command"])
    bench.manifest("middle", "stack:Middle", requires=["low"], visibility=["*", "command"])
    bench.manifest("top", "stack:Top", requires=["middle"])
    bench.manifest("beside", "stack:Low")
    bench.manager = bench.start("top", "beside").manager
    bench.diary = bench.plugin("low").ping.__func__.__globals__["DIARY"]
    return bench


def test_what_others_require_is_not_unloaded_and_they_are_named(stack):
    with pytest.raises(PluginInUse, match="low is required by top, middle: unload these first") as no:
        stack.manager.unload("low")
    assert no.value.users == ["top", "middle"]
    assert {info.state for info in stack.infos().values()} == {"active"}
    with pytest.raises(CallError) as refused:
        stack.wire.ask(HOST_UNLOAD, UnloadRequest(plugin="low"), robot="r1")
    assert refused.value.code is ErrorCode.REFUSED


def test_cascade_unloads_the_users_first(stack):
    tags = stack.manager.unload("low", cascade=True)
    assert [tag.name for tag in tags] == ["top", "middle", "low"]
    assert stack.diary == ["top", "middle", "low"]
    assert [tag.state for tag in tags] == ["unloaded"] * 3
    assert list(stack.infos()) == ["beside"]


def test_a_handle_on_what_was_unloaded_says_so(stack):
    middle = stack.plugin("middle")
    handle, ping = middle.low, middle.low.ping
    stack.manager.unload("low", cascade=True)
    for call in (ping, lambda: handle.ping()):
        with pytest.raises(PluginUnloaded, match="low is unloaded") as gone:
            call()
        assert gone.value.plugin == "low"
    stack.manager.load("low")  # another of that name is not the one that the handle was given for
    with pytest.raises(PluginUnloaded):
        ping()


def test_a_call_from_outside_to_what_was_unloaded_is_answered(stack):
    stack.manager.unload("top")
    tag = stack.manager.get("middle")
    stack.manager.unload("middle")
    with pytest.raises(CallError, match="no plugin middle; there are: ") as refused:
        stack.wire.ask(ROBOT_CALL, robot="r1", plugin="middle", function="ping")
    assert refused.value.code is ErrorCode.UNKNOWN_PLUGIN
    with pytest.raises(CallError) as late:  # it was on its way already
        tag.call_external("ping", b"")
    assert late.value.code is ErrorCode.UNLOADED


def test_a_plugin_that_raises_when_it_is_unloaded_goes_all_the_same(stack):
    stack.manifest("stubborn", "stack:Stubborn", requires=["low"])
    stack.manager.load("stubborn")
    stack.manager.unload("stubborn")
    assert "stubborn" not in stack.infos()


def test_a_plugin_that_was_left_out_can_be_unloaded(stack):
    stack.manifest("odd", "stack:Nowhere")
    stack.hosts.pop().close()
    manager = stack.start("odd").manager
    assert stack.infos()["odd"].state == "faulted"
    manager.unload("odd")
    assert stack.infos() == {}
