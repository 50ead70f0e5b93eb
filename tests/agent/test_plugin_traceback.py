"""Every report of a plugin's error has the author's file, line and traceback."""

import pytest

from robrain.agent import plugin_traceback
from robrain.agent.plugin_traceback import MOST_CHARACTERS
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, LoadRequest

LAMP = """
import helper

class Lamp(Unit):
    period_s = 0.02
    broken = False
    def step(self):
        if self.broken: helper.divide(0)
    @external
    def dim(self, to: int) -> int: return helper.divide(to)
    @external
    def refuse(self) -> int: raise PluginError("lamp", "not now")
"""
HELPER = "def divide(by):\n    return 1 // by\n"


@pytest.fixture
def lamp(bench, monkeypatch):
    """A robot with a plugin `lamp` in the folder `lamp`; its path."""
    bench.place = bench.place / "lamp"
    bench.place.mkdir()
    monkeypatch.syspath_prepend(bench.place)
    monkeypatch.delitem(__import__("sys").modules, "helper", raising=False)
    (bench.place / "helper.py").write_text(HELPER)
    bench.code("lamp", LAMP)
    bench.manifest("lamp", "lamp:Lamp")
    return bench.place


def line_of(path, text: str) -> int:
    return next(number for number, line in enumerate(path.read_text().splitlines(), 1) if text in line)


def traceback_of_step(lamp) -> str:
    line = line_of(lamp / "lamp.py", "if self.broken")
    return (
        "Traceback (most recent call last):\n"
        f'  File "lamp/lamp.py", line {line}, in step\n'
        "    if self.broken: helper.divide(0)\n"
        '  File "lamp/helper.py", line 2, in divide\n'
        "    return 1 // by\n"
        "ZeroDivisionError: integer division or modulo by zero"
    )


def untangled(text: str) -> str:
    """The traceback without the markers that some versions of Python print below a line."""
    return "\n".join(line for line in text.splitlines() if line.strip(" ~^"))


def test_a_plugin_tells_where_a_thread_is_in_it(bench, lamp, monkeypatch):
    found, tag = [], bench.start("lamp").manager.get("lamp")
    helper = tag.plugin_class.dim.__globals__["helper"]
    monkeypatch.setattr(helper, "divide", lambda _: found.append(tag.stuck_at()) or 7)
    assert (bench.call("lamp", "dim", [1]), tag.stuck_at()) == (7, None)
    assert [frame.tb_frame.f_code.co_name for frame in found] == ["dim"]


def test_a_fault_is_listed_with_its_line_and_traceback(bench, lamp):
    bench.start("lamp")
    bench.plugin("lamp").broken = True
    bench.tick()
    info = bench.infos()["lamp"]
    assert (info.state, info.why) == ("faulted", "ZeroDivisionError: integer division or modulo by zero")
    assert info.where == "lamp/helper.py:2 in divide"
    assert untangled(info.detail) == traceback_of_step(lamp)


def test_a_call_that_raises_answers_with_the_traceback_and_logs_it(bench, lamp, caplog):
    bench.start("lamp")
    with pytest.raises(CallError) as raised:
        bench.call("lamp", "dim", [0])
    error = raised.value
    assert (error.code, error.message) == (ErrorCode.FAILED, "ZeroDivisionError: integer division or modulo by zero")
    assert 'File "lamp/lamp.py", line' in error.detail
    assert 'File "lamp/helper.py", line 2, in divide' in error.detail
    assert "agent/" not in error.detail
    assert error.detail in caplog.text
    with pytest.raises(CallError) as raised:
        bench.call("lamp", "refuse")
    assert (raised.value.message, raised.value.detail) == ("not now", "")  # a refusal is not an error of the plugin


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("import helper", "import helper\nhelper.divide(0)", "lamp/helper.py:2 in divide"),  # while it is imported
        ("import helper", "import helper, no_such_module", "lamp/lamp.py:8 in <module>"),
        ("import helper", "def broken(:", "lamp/lamp.py:8"),  # not even Python
        ("broken = False", "def init(self): helper.divide(0)", "lamp/helper.py:2 in divide"),
        ("broken = False", "def activate(self): self.env.use('ghost', int)", "lamp/lamp.py:12 in activate"),
    ],
)
def test_a_load_that_fails_answers_with_the_line_and_traceback_and_logs_them(bench, lamp, caplog, old, new, where):
    bench.code("base", "class Base(Unit): pass")
    bench.manifest("base", "base:Base")
    bench.start("base")
    source = lamp / "lamp.py"
    source.write_text(source.read_text().replace(old, new))
    with pytest.raises(CallError) as raised:
        bench.wire.ask(HOST_LOAD, LoadRequest(plugin="lamp"), robot="r1")
    file, _, line = where.partition(" ")[0].partition(":")
    assert f'File "{file}", line {line}' in raised.value.detail
    assert str(lamp.parent) not in raised.value.detail
    assert raised.value.detail in caplog.text


def fall(depth: int) -> None:
    if depth:
        fall(depth - 1)
    else:
        raise ValueError("x" * 10_000)


def test_a_long_traceback_keeps_its_beginning_and_end_within_a_bound():
    with pytest.raises(ValueError, match="xxx") as raised:
        fall(100)
    detail = plugin_traceback.raised(raised.value).detail
    assert len(detail) == MOST_CHARACTERS
    assert detail.endswith("xxx")
    with pytest.raises(RecursionError) as deep:
        fall(10**6)
    detail = plugin_traceback.raised(deep.value).detail
    assert detail.startswith("Traceback (most recent call last):\n")
    assert " more …\n" in detail
    assert detail.count("in fall") <= 20
    assert "RecursionError" in detail
