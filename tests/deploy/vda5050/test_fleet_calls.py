"""The gateway's calls to the team: what counts as refused for good, and what is asked again; and its order file."""

from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.vda5050.fleet_process import OrderFile, TeamCalls
from robrain.deploy.vda5050.messages import OrderNode
from robrain.deploy.vda5050.robot_orders import KeptOrder, NodeTask
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import TaskState

TASK = NodeTask("o-2", OrderNode("n", 2, True, []), Point2D(1.0, 2.0), 0.0, "o-1")


class FakeClient:
    """A client of a team that answers every call with an error."""

    code = ErrorCode.REFUSED

    def submit(self, *_: Any, **_fields: Any) -> None:
        raise CallError(self.code, "no")

    cancel = get = submit

    def close(self) -> None: ...


def test_only_a_refusal_ends_a_task(monkeypatch: pytest.MonkeyPatch) -> None:
    client: Any = FakeClient()
    with closing(TeamCalls(lambda: client)) as calls:
        assert calls.submit(TASK, "r1").result() == (TaskState.FAILED, "no")
        assert calls.cancel("o-2").result() == (TaskState.CANCELLED, "no")
        monkeypatch.setattr(client, "code", ErrorCode.TIMEOUT)
        for call in (calls.submit(TASK, "r1"), calls.cancel("o-2"), calls.get("o-2")):
            with pytest.raises(CallError):
                call.result()


def test_an_order_is_on_disk_and_a_damaged_file_is_refused(tmp_path: Path) -> None:
    file = OrderFile(tmp_path / "orders")
    assert file.read("r1") == KeptOrder()
    kept = KeptOrder("o", 3, [TASK.node], [], "d", ["c"])
    file.write("r1", kept)
    assert OrderFile(tmp_path / "orders").read("r1") == kept
    (tmp_path / "orders" / "r1.json").write_bytes(msgspec.json.encode([1]))
    with pytest.raises(UsageError, match=r"r1\.json"):
        file.read("r1")
