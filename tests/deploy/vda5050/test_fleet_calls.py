"""The gateway's calls to the team: what counts as refused for good, and what is asked again; and its order file."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.deploy.command_line.options import write_file
from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.fleet_process import KeptOrder, ask_coordinator, read_order
from robrain.deploy.vda5050.messages import OrderNode
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState

TASK = Task(id="o-2", kind="visit", place=Point2D(1.0, 2.0), after=["o-1"])


class FakeEndpoint:
    """An endpoint at which every query is answered with an error."""

    def __init__(self, code: ErrorCode) -> None:
        self.code = code

    def ask(self, *_: Any) -> None:
        raise CallError(self.code, "no")


def test_only_a_refusal_ends_a_task() -> None:
    wire: Any = FakeEndpoint(ErrorCode.REFUSED)
    assert ask_coordinator(wire, TASK, is_cancelled=False) == (TaskState.FAILED, "no")
    assert ask_coordinator(wire, TASK, is_cancelled=True) == (TaskState.CANCELLED, "no")
    wire.code = ErrorCode.TIMEOUT
    for is_cancelled in (False, True):
        with pytest.raises(CallError):
            ask_coordinator(wire, TASK, is_cancelled=is_cancelled)


def test_an_order_is_read_from_disk_and_a_damaged_file_is_refused(tmp_path: Path) -> None:
    assert read_order(tmp_path / "r1.json").nodes == []
    kept = KeptOrder("o", 3, [OrderNode(2, True, [], "n")], [], ["c"])
    write_file(tmp_path / "r1.json", msgspec.json.encode(kept))
    assert read_order(tmp_path / "r1.json") == kept
    (tmp_path / "r1.json").write_bytes(msgspec.json.encode([1]))
    with pytest.raises(UsageError, match=r"r1\.json"):
        read_order(tmp_path / "r1.json")
