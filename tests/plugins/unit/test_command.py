from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.plugins.device.command import Command
from robrain.plugins.unit.tcp_socket import MAX_LINE_BYTES, Conversation
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import PluginInfo


class Door:
    """The robot's plugins, as far as they are played here."""

    def plugins(self):
        return [PluginInfo(name=name, level="unit", state="active") for name in ("battery", "driver")]

    def call_text(self, text):
        if text == "crash":
            raise RuntimeError("it went\nwrong")
        if text == "nothing":
            return ""
        if text == "refuse":
            raise CallError(ErrorCode.BUSY, "somebody else drives")
        return f"did {text}"


def command(outside):
    return Command(SimpleNamespace(plugin="command", outside=outside), None)


COMMAND = command(Door())


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("this", "ok did this"),
        ("nothing", "ok"),
        ("refuse", "error busy: somebody else drives"),
        ("crash", "error failed: RuntimeError: it went\nwrong"),
    ],
)
def test_every_command_is_answered_ok_or_error(text, answer):
    assert COMMAND.execute(text) == answer


def test_command_tells_who_is_open_to_the_outside():
    assert COMMAND.plugins() == "battery driver"


def test_a_second_plugin_of_the_class_is_not_let_in():
    assert command(None).execute("this").startswith("error forbidden: ")


def talk(*received):
    conversation = Conversation(COMMAND.execute)
    return [answer for part in received for answer in conversation.feed(part)] + list(conversation.end())


@pytest.mark.parametrize(
    ("received", "answers"),
    [
        ([b"a\nb\n"], [b"ok did a\n", b"ok did b\n"]),  # an answer for each line
        ([b"a", b"b\r", b"\nc\n"], [b"ok did ab\n", b"ok did c\n"]),  # however it comes
        ([b"\n"], [b"ok did \n"]),  # also for an empty one
        ([b"crash\n"], [b"error failed: RuntimeError: it went | wrong\n"]),  # in one line
        (["grüß\n".encode()], ["ok did grüß\n".encode()]),
        ([b"\xff\nb\n"], [b"error bad_arguments: the line is not UTF-8 at byte 0\n", b"ok did b\n"]),
        ([b"a\nb"], [b"ok did a\n", b"error bad_arguments: the last line has no end, so it was not executed\n"]),
    ],
)
def test_a_conversation_has_an_answer_for_each_line(received, answers):
    assert talk(*received) == answers


@pytest.mark.parametrize("size", [1, 100, MAX_LINE_BYTES, 10 * MAX_LINE_BYTES])
def test_a_line_that_is_too_long_is_answered_once_and_the_conversation_goes_on(size):
    text = b"x" * (3 * MAX_LINE_BYTES) + b"\nb\n"
    parts = [text[start : start + size] for start in range(0, len(text), size)]
    assert talk(*parts) == [b"error bad_arguments: the line is longer than 4096 bytes\n", b"ok did b\n"]


@given(st.lists(st.binary(max_size=200) | st.sampled_from([b"\n", b"crash\n", b"x" * 5000])))
def test_any_bytes_are_answered_line_by_line(received):
    answers = talk(*received)
    ended = b"".join(received).count(b"\n")
    assert ended <= len(answers) <= ended + 1
    for answer in answers:
        assert answer.startswith((b"ok", b"error "))
        assert answer.endswith(b"\n")
        assert answer.count(b"\n") == 1
        if answer.startswith(b"error "):
            assert ErrorCode(answer[6:].partition(b":")[0].decode())


def test_a_robots_command_calls_the_robots_plugins(stage):
    one = stage()
    host = one.host("teammates", "tcp_socket", "driver")
    robot = host.manager.get("command").plugin
    assert robot.execute("call teammates others()") == "ok []"
    assert robot.execute("call tcp_socket int.port()") == "ok 0"
    assert robot.execute("call driver motion()") == "ok stopped"
    assert robot.execute("call command execute(list)").startswith("error forbidden: ")  # nor does it call itself
    assert robot.plugins() == robot.execute("list").removeprefix("ok ")
    host.manager.halt()
    assert robot.execute("call driver motion()") == "error halted: driver is halted"
