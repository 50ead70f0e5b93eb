"""An exclusive plugin may be held from outside, for a time."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.agent.errors import PluginBusy
from robrain.agent.lifecycle.access import ExclusiveUse
from robrain.protocol.clock import VirtualClock, to_ns
from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_HOLD, HOST_RELEASE, LONGEST_LEASE_S
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from tests.agent.conftest import refused

LAB = """
    class ArmInterface(Protocol):
        def reach(self) -> str: ...

    class Arm(Device):
        interface = ArmInterface
        @external
        def reach(self) -> str: return "reached"
        period_s = 0.02
        broken = False
        def step(self):
            if self.broken: raise RuntimeError("bent")

    class Worker(Unit):
        def activate(self): self.arm = self.env.use("arm", ArmInterface)
"""


@pytest.fixture
def lab(bench):
    bench.code("lab", LAB)
    bench.manifest("arm", "lab:Arm", visibility=["worker", "command"], shared=False)
    bench.manifest("lamp", "lab:Arm", visibility=["command"])
    bench.manifest("hidden", "lab:Arm", visibility=["worker"], shared=False)
    bench.manifest("worker", "lab:Worker", requires=["arm"])
    bench.start("arm", "lamp", "hidden")
    return bench


def ask(lab, query, **fields):
    return lab.wire.ask(query, query.request(**{"plugin": "arm", **fields}), robot="r1")


def reach(lab, by=""):
    reply = lab.wire.ask(ROBOT_CALL, by=by, robot="r1", plugin="arm", function="reach")
    return msgspec.json.decode(reply)


def busy(function, *args, **fields):
    """The holder, by the refusal."""
    error = refused(function, *args, **fields)
    assert error.code is ErrorCode.BUSY
    return error.detail


def test_nobody_but_the_holder_may_call_it_and_the_refusal_names_the_holder(lab):
    assert reach(lab) == "reached"
    lease = ask(lab, HOST_HOLD, by="ann", lease_s=2.0)
    assert (lease.plugin, lease.holder, lease.until_ns) == ("arm", "ann", to_ns(2.0))
    assert reach(lab, by="ann") == "reached"
    assert busy(reach, lab) == "ann"
    assert busy(reach, lab, by="bob") == "ann"
    assert lab.infos()["arm"].holder == "ann"


def test_a_second_holder_is_refused_until_the_first_lets_go(lab):
    ask(lab, HOST_HOLD, by="ann")
    assert busy(ask, lab, HOST_HOLD, by="bob") == "ann"
    assert ask(lab, HOST_RELEASE, by="bob") is False
    assert ask(lab, HOST_RELEASE, by="ann") is True
    assert ask(lab, HOST_RELEASE, by="ann") is False
    assert ask(lab, HOST_HOLD, by="bob").holder == "bob"


def test_a_lease_ends_by_itself_unless_it_is_renewed(lab):
    ask(lab, HOST_HOLD, by="ann", lease_s=1.0)
    lab.tick(40)
    ask(lab, HOST_HOLD, by="ann", lease_s=1.0)
    lab.tick(49)
    assert busy(reach, lab) == "ann"
    lab.tick(1)
    assert reach(lab) == "reached"
    assert lab.infos()["arm"].holder == ""


def test_a_plugin_held_from_outside_is_refused_inside_naming_the_holder(lab):
    host = lab.hosts[-1]
    ask(lab, HOST_HOLD, by="ann", lease_s=1.0)
    with pytest.raises(PluginBusy, match="arm is held by ann"):
        host.manager.load("worker")
    lab.tick(50)
    host.manager.load("worker")
    assert lab.infos()["arm"].holder == "worker"


def test_a_plugin_held_inside_is_refused_outside_also_in_the_holders_name(lab):
    lab.hosts[-1].manager.load("worker")
    assert busy(ask, lab, HOST_HOLD, by="ann") == "worker"
    assert busy(ask, lab, HOST_HOLD, by="worker") == "worker"
    assert busy(reach, lab, by="worker") == "worker"
    lab.hosts[-1].manager.unload("worker")
    assert reach(lab) == "reached"


def test_a_fault_and_an_unload_end_the_lease(lab):
    ask(lab, HOST_HOLD, by="ann")
    lab.plugin("arm").broken = True
    lab.tick(2)
    assert lab.infos()["arm"].state == "faulted"
    manager = lab.hosts[-1].manager
    manager.load("arm")
    assert reach(lab) == "reached"
    ask(lab, HOST_HOLD, by="ann")
    manager.unload("arm")
    manager.load("arm")
    assert reach(lab) == "reached"


@pytest.mark.parametrize(
    ("plugin", "fields", "code"),
    [
        ("lamp", {"by": "ann"}, ErrorCode.REFUSED),  # shared
        ("hidden", {"by": "ann"}, ErrorCode.FORBIDDEN),  # not open to the outside
        ("ghost", {"by": "ann"}, ErrorCode.UNKNOWN_PLUGIN),  # not there
        ("arm", {}, ErrorCode.BAD_ARGUMENTS),  # nobody
        ("arm", {"by": "ann", "lease_s": 0.0}, ErrorCode.BAD_ARGUMENTS),  # no time
        ("arm", {"by": "ann", "lease_s": 1e9}, ErrorCode.BAD_ARGUMENTS),  # for ever
    ],
)
def test_what_cannot_be_held_is_refused(lab, plugin, fields, code):
    assert refused(ask, lab, HOST_HOLD, plugin=plugin, **{"by": "", **fields}).code is code
    assert lab.infos()["arm"].holder == ""


@given(st.lists(st.tuples(st.sampled_from("ab"), st.floats(0.1, LONGEST_LEASE_S), st.floats(0.0, 40.0))))
def test_there_is_one_holder_at_most_and_only_within_its_time(steps):
    clock = VirtualClock()
    use = ExclusiveUse("p", clock)
    holder, until_ns = "", 0
    for who, lease_s, wait_s in steps:
        if clock.now_ns() >= until_ns:
            holder = ""
        if holder in ("", who):
            holder, until_ns = who, use.lease(who, lease_s).until_ns
            assert until_ns == clock.now_ns() + to_ns(lease_s)
        else:
            with pytest.raises(PluginBusy, match=f"held by {holder}"):
                use.lease(who, lease_s)
        clock.advance_to(clock.now_ns() + to_ns(wait_s))
        assert use.by == (holder if clock.now_ns() < until_ns else "")
