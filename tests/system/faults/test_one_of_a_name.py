"""Real processes that start under a name already taken, or at the same time as another."""

import signal
import subprocess

import pytest

from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system

ROBOT = '[robot]\nname = "r1"\nload = ["counter"]\n\n[zenoh]\nconnect = ["{endpoint}"]\n'
UP = {"agent": "agent: r1 is up", "coordinator": "coordinator: of team default; Ctrl-C"}
NAMED = {"agent": "robot r1 of team default", "coordinator": "the coordinator of team default"}


@pytest.fixture(params=["agent", "coordinator"])
def kind(request) -> str:
    return request.param


@pytest.fixture
def start(commands, kind):
    """Starts one more process of the same name."""
    hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    endpoint = next(where for where in listening_at(hub) if where.startswith("tcp/"))
    (commands.folder / "r1.toml").write_text(ROBOT.format(endpoint=endpoint))
    number = iter(range(100))

    def start() -> subprocess.Popen[str]:
        if kind == "agent":
            return commands.start("agent", "r1.toml")
        return commands.start("coordinator", "--connect", endpoint, "--journal", f"{next(number)}.journal")

    yield start
    commands.stop_all()
    hub.close()  # type: ignore[no-untyped-call]


def test_a_process_that_hangs_beyond_its_lease_loses_its_name_and_ends_when_it_goes_on(commands, start, kind) -> None:
    first = start()
    commands.line_with(first, UP[kind])
    first.send_signal(signal.SIGSTOP)
    second = start()
    commands.line_with(second, UP[kind])
    assert first.poll() is None
    first.send_signal(signal.SIGCONT)
    said, _ = first.communicate(timeout=PATIENCE_S)
    assert first.returncode == 2
    last = said.splitlines()[-1]
    assert last.startswith(
        f"robrain: this process hung, and {NAMED[kind]} is another one now: process {second.pid} on "
    )
    assert second.poll() is None
