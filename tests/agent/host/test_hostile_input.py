"""Bytes that mean nothing, at every door of a robot: always an error answer of the enum, and the robot goes on."""

import random
from pathlib import Path

import msgspec
import pytest

from robrain.protocol.errors import ErrorCode, ErrorReply
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.table.topics import HOST_VERB

COUNT = 2500
WARM_UP = 500

LAB = """
    class Lamp(Device):
        @external
        def dim(self, to: float, names: list[str] = [], table: dict[str, int] = {}) -> float: return to
        @external
        def hello(self, name: str = "world") -> str: return f"hello {name}"
"""
WORDS = [
    *rb"""[plugin] [parameters] [tag] class = "lab:Lamp" "lab:Lamp lab requires [ ] { } " ' , : ( )""".split(),
    *rb"""null true 1e999 -1 0.5 NaN \ud800 call list help lamp dim hello name= . "plugin" "text" "cascade" """.split(),
    *(b"visibility", b"'''", b"#", b"1979-05-27", b"\n", b" ", b"\xff", b"\x00", b"\xe2\x86\x92", b'"""'),
    *(b"[" * 2000, b"9" * 5000),
]


def hostile(seed, count=COUNT):
    """Random bytes: plain noise, words that the parsers know in any order, and sound input with bytes changed."""
    draw = random.Random(seed)
    sound = [
        b'[plugin]\nclass = "lab:Lamp"\n[tag]\nrequires = []\nhang_s = 1.5 # a comment may be anything\n',
        b'[0.5, ["a", "b"], {"a": 1}]',
        b'{"to": 0.5}',
        b'{"plugin": "lamp", "cascade": false, "text": "call lamp hello(x)"}',
        b"call lamp dim(0.5)",
    ]
    for number in range(count):
        kind = number % 3
        if kind == 0:
            yield draw.randbytes(draw.randrange(200))
        elif kind == 1:
            yield b"".join(draw.choices(WORDS, k=draw.randrange(1, 12)))
        else:
            changed = bytearray(draw.choice(sound))
            for _ in range(draw.randrange(1, 4)):
                changed[draw.randrange(len(changed))] = draw.randrange(draw.choice((128, 256)))
            yield bytes(changed)


@pytest.fixture
def lab(bench):
    bench.code("lab", LAB)
    bench.manifest("lamp", "lab:Lamp")
    bench.start("lamp")
    bench.states = Inbox(every=True)
    bench.wire.subscribe(bench.states, ROBOT_STATE)
    return bench


def rss_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def try_all(lab, attempt, seed, count=COUNT, warm_up=WARM_UP):
    """Every one of them, then see that the robot is well and no bigger."""
    rss = 0
    for number, data in enumerate(hostile(seed, count)):
        if number == warm_up:
            rss = rss_bytes()
        attempt(data)
    assert rss_bytes() - rss < 5_000_000
    lab.states.drain()
    lab.tick(10)
    assert lab.states.drain()
    assert lab.infos()["lamp"].state == "active"
    assert lab.call("lamp", "dim", [0.5]) == 0.5


def ask(lab, key, data):
    """The one answer to a query: a decoded result, or an ErrorReply, which decodes only with a code of the enum."""
    replies = list(lab.session.get(key, payload=data, timeout=5.0))
    assert len(replies) == 1
    (reply,) = replies
    if reply.ok is not None:
        return msgspec.json.decode(reply.ok.payload.to_bytes())
    return msgspec.json.decode(reply.err.payload.to_bytes(), type=ErrorReply)


@pytest.mark.parametrize("function", ["dim", "hello"])
def test_call_payloads(lab, function):
    key = ROBOT_CALL.key("default", robot="r1", plugin="lamp", function=function)
    codes = set()

    def attempt(data):
        answer = ask(lab, key, data)
        codes.add(answer.code if isinstance(answer, ErrorReply) else "a result")

    try_all(lab, attempt, seed=1)
    assert codes == {ErrorCode.BAD_ARGUMENTS, "a result"}


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["load", "unload", "reload", "command", "halt", "nonsense"])
def test_requests_to_the_host(lab, verb, monkeypatch, tmp_path_factory):
    monkeypatch.chdir(tmp_path_factory.mktemp("empty"))
    key = HOST_VERB.key("default", robot="r1", verb=verb)
    seen = set()

    def attempt(data):
        if verb == "unload" and b'"lamp"' in data:
            return  # a sound request, which would be obeyed
        answer = ask(lab, key, data)
        if lab.hosts[-1].manager.halted:  # as was this one
            lab.hosts[-1].manager.resume()
        seen.add(isinstance(answer, ErrorReply))

    try_all(lab, attempt, seed=2)
    assert True in seen


def test_commands_in_text_form(lab):
    key = HOST_VERB.key("default", robot="r1", verb="command")
    answers = {"errors": 0, "results": 0}

    def attempt(data):
        text = data.decode("utf-8", errors="replace")
        answer = ask(lab, key, msgspec.json.encode({"text": text}))
        answers["errors" if isinstance(answer, ErrorReply) else "results"] += 1

    try_all(lab, attempt, seed=3)
    assert all(answers.values())


@pytest.mark.slow
def test_manifests(lab):
    manager = lab.hosts[-1].manager
    odd = lab.place / "odd.toml"
    refused = loaded = 0

    def attempt(data):
        nonlocal refused, loaded
        odd.write_bytes(data)
        answer = ask(lab, HOST_VERB.key("default", robot="r1", verb="load"), b'{"plugin": "odd"}')
        if isinstance(answer, ErrorReply):
            refused += 1
            assert answer.message
            assert list(manager.plugins) == ["lamp"]
        else:
            loaded += 1
            manager.unload("odd")

    try_all(lab, attempt, 4, count=250, warm_up=150)  # each is written to a file, and loaded
    assert refused > loaded > 0
