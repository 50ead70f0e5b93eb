"""The bench for plugins that are processes of their own."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import pytest

from robrain import AccessDenied, CallError, ErrorCode, Level, NobodyThere
from robrain.agent.authoring import foreign_bench
from robrain.testing import ForeignBench
from tests.agent.conftest import refused

pytestmark = pytest.mark.system

PROCESS = """
import os, time
from robrain.protocol.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.protocol.wire.session import open_session
from robrain.protocol.messages.robots.plugin_messages import ROBOT_FOREIGN, ROBOT_FOREIGN_CALL, ROBOT_FOREIGN_INFO

add = FunctionInfo(name="add", signature="()", doc="", parameters={"type": "object"}, returns={})
info = PluginInfo(name="gauge", level="device", state="active", visibility=["command", "driver"], functions=[add])
wire = Endpoint(open_session(connect=[os.environ["ROBRAIN_CONNECT"]]), "default", LiveClock(), Drive.LIVE)
wire.answer(ROBOT_FOREIGN_INFO, lambda request: info, robot="r1", plugin="gauge")
wire.answer(ROBOT_FOREIGN_CALL, lambda request: request.asked or b"5", robot="r1", plugin="gauge")
wire.token(ROBOT_FOREIGN, robot="r1", plugin="gauge")
time.sleep(300)
"""


class GaugeInterface(Protocol):
    def add(self) -> dict[str, int]: ...


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> list[str | Path]:
    path = tmp_path_factory.mktemp("gauge") / "gauge.py"
    path.write_text(PROCESS)
    return [sys.executable, path]


@pytest.fixture
def gauge(command: list[str | Path]) -> Iterator[ForeignBench]:
    with ForeignBench(command, plugin="gauge") as bench:
        yield bench


def test_it_is_listed_called_used_and_missed(gauge: ForeignBench) -> None:
    assert (gauge.info().name, gauge.info().level) == ("gauge", "device")
    assert gauge.call("add") == 5
    assert gauge.call("add", [2, 3]) == [2, 3]
    assert gauge.call("add", {"b": 2}) == {"b": 2}
    assert gauge.call_directly("wipe", [1]) == [1]
    assert gauge.use(GaugeInterface).add() == {}
    with pytest.raises(AccessDenied, match="calls go to lower levels only"):
        gauge.use(GaugeInterface, level=Level.DEVICE)
    assert refused(gauge.call, "wipe").code is ErrorCode.UNKNOWN_FUNCTION
    gauge.kill()
    with pytest.raises(CallError, match="no foreign plugin gauge"):
        gauge.call("add")
    with pytest.raises(NobodyThere):
        gauge.call_directly("add")


def test_a_process_that_announces_something_else_is_told_and_ended(
    command: list[str | Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foreign_bench, "PATIENCE_S", 0.3)
    bench = ForeignBench(command, plugin="lamp")
    with pytest.raises(TimeoutError, match=r"lamp of r1 has not announced its plugin after 0\.3 s"), bench:
        pass
    assert bench.process.status is not None
