"""The verbs of a robot's host: each takes only its own requests; unknown ones are refused; others may be installed."""

import json

import pytest

from robrain.agent.host import host_verbs
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import (
    HOST_COMMAND,
    HOST_HALT,
    HOST_HOLD,
    HOST_LOAD,
    HOST_RELEASE,
    HOST_RELOAD,
    HOST_RESUME,
    HOST_UNLOAD,
    CommandRequest,
    HoldRequest,
    UnloadRequest,
)
from robrain.protocol.registry import Registry
from robrain.protocol.table.topics import HOST_VERB, all_rows
from robrain.protocol.wire.endpoint import Request
from tests.hostile_payloads import fixed_payloads
from tests.installed_distributions import install  # noqa: F401 - a fixture

LAB = """
    class Lamp(Device):
        @external
        def hello(self) -> str: return "hello"
"""
BLINK = """
import msgspec
from robrain.agent.host.host_verbs import HostVerb
from robrain.protocol.model.ranges import Count
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import (host_query)

class BlinkRequest(msgspec.Struct, frozen=True, kw_only=True):
    times: Count

def run(host, request):
    if request.asked.times == 13:
        raise CallError(ErrorCode.REFUSED, "13 brings bad luck")
    if request.asked.times == 14:
        raise SystemExit
    return [host.name] * request.asked.times

blink = HostVerb(host_query("blink", BlinkRequest, list[str], "Blink", ErrorCode.REFUSED), run)
"""


@pytest.fixture
def lab(bench):
    bench.code("lab", LAB)
    bench.manifest("lamp", "lab:Lamp", visibility=["command"], shared=False)
    bench.start("lamp")
    return bench


@pytest.fixture
def verbs(monkeypatch):
    """The registry as it is when a process starts: it has not looked at what is installed."""
    stock = {verb: f"robrain.agent.host.host_verbs:{verb.upper()}" for verb in STOCK}
    monkeypatch.setattr(host_verbs, "HOST_VERBS", Registry("host verb", "robrain.host_verbs", stock))


HOST_QUERIES = [row for row in all_rows() if row.name.startswith("host_")]
STOCK = [query.chunks[-1] for query in HOST_QUERIES]


def refusals(lab, topic):
    return sum(one.count for one in lab.hosts[-1].refusals.counts() if one.topic == topic)


def ask(lab, verb, data):
    return lab.wire.ask(HOST_VERB, data, robot="r1", verb=verb)


def refused(lab, verb, data=b"{}"):
    with pytest.raises(CallError) as error:
        ask(lab, verb, data)
    return error.value.code, error.value.message


def test_every_reply_decodes_as_its_row_says(lab):
    lease = lab.wire.ask(HOST_HOLD, HoldRequest(plugin="lamp", by="ann"), robot="r1")
    assert (lease.plugin, lease.holder) == ("lamp", "ann")
    assert lab.wire.ask(HOST_COMMAND, CommandRequest(text="call lamp hello()", by="ann"), robot="r1") == "hello"
    assert lab.wire.ask(HOST_RELEASE, HOST_RELEASE.request(plugin="lamp", by="ann"), robot="r1") is True
    assert lab.wire.ask(HOST_HALT, robot="r1").halted
    assert not lab.wire.ask(HOST_RESUME, robot="r1").halted
    assert [info.name for info in lab.wire.ask(HOST_RELOAD, HOST_RELOAD.request(plugin="lamp"), robot="r1")] == ["lamp"]
    assert [info.name for info in lab.wire.ask(HOST_UNLOAD, UnloadRequest(plugin="lamp"), robot="r1")] == ["lamp"]
    assert [info.name for info in lab.wire.ask(HOST_LOAD, HOST_LOAD.request(plugin="lamp"), robot="r1")] == ["lamp"]


@pytest.mark.parametrize("query", HOST_QUERIES, ids=lambda query: query.name)
def test_a_hostile_request_is_refused_counted_and_reaches_no_verb(lab, query):
    bad = 0
    for data in fixed_payloads(query):
        try:
            query.requests.read(data)
        except BadPayload as error:
            if error.is_too_large:  # refused before the verb is known
                continue
            bad += 1
            assert refused(lab, query.chunks[-1], data)[0] is ErrorCode.BAD_ARGUMENTS
    assert bad
    assert refusals(lab, query.name) == bad
    assert lab.infos()["lamp"].state == "active"


def test_an_unknown_verb_is_refused_with_the_list_and_the_nearest_and_counted(lab):
    code, words = refused(lab, "lod", b"{")
    assert code is ErrorCode.UNKNOWN_FUNCTION
    assert all(verb in words for verb in STOCK)
    assert words.endswith("got lod; did you mean load?")
    assert refusals(lab, HOST_VERB.name) == 1


def test_a_distribution_brings_a_verb(lab, verbs, install):  # noqa: F811
    install("blinkers", {"blink": "blinkers:blink"}, {"blinkers.py": BLINK}, "robrain.host_verbs")
    assert json.loads(ask(lab, "blink", b'{"times": 2}')) == ["r1", "r1"]
    assert refused(lab, "blink", b'{"times": -1}')[0] is ErrorCode.BAD_ARGUMENTS
    assert refusals(lab, "host_blink") == 1
    assert refused(lab, "blink", b'{"times": 13}') == (ErrorCode.REFUSED, "13 brings bad luck")
    assert refused(lab, "blink", b'{"times": 14}')[0] is ErrorCode.FAILED
    assert "did you mean blink?" in refused(lab, "blonk")[1]


@pytest.mark.parametrize(
    ("points", "code", "words"),
    [
        ({"blonk": "blinkers:blink"}, BLINK, "is no HostVerb of that name"),  # its row has another name
        ({"blonk": "blinkers:blink"}, "raise RuntimeError('no bulbs')", "RuntimeError: no bulbs"),
    ],
)
def test_a_verb_that_is_none_fails_in_words(lab, verbs, install, points, code, words):  # noqa: F811
    install("blinkers", points, {"blinkers.py": code}, "robrain.host_verbs")
    assert refused(lab, "blonk")[0] is ErrorCode.FAILED
    assert words in refused(lab, "blonk")[1]
    assert lab.infos()["lamp"].state == "active"


def test_no_distribution_replaces_a_halt(lab, verbs, install):  # noqa: F811
    install("blinkers", {"halt": "blinkers:blink"}, {"blinkers.py": BLINK}, "robrain.host_verbs")
    assert lab.wire.ask(HOST_HALT, robot="r1").halted
    assert lab.hosts[-1].manager.halted


def test_in_a_secured_team_a_verb_is_run_in_the_name_of_the_member_that_asks_and_of_no_other(lab):
    (host,), ann = lab.hosts, Member(MemberRole.OPERATOR, "default", "ann")

    def halted_by(claimed):
        asked = Request({"verb": "halt"}, json.dumps({"by": claimed}).encode(), asker=ann)
        return json.loads(host_verbs.answer_verb(host, lab.wire, asked))["by"]

    assert halted_by("ann") == ["operator:ann"]
    with pytest.raises(CallError, match="its key says operator:ann, its request operator:bob"):
        halted_by("operator:bob")
