"""`robrain bridge`: join two teams on purpose."""

import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer

from robrain.deploy.commands.team_options import ConnectOption, say

if TYPE_CHECKING:
    from robrain.deploy.bridge.bridge import Counts

LOOK_S = 0.05
"""How often queries that wait for an answer are looked at."""
TELL_S = 60.0
"""How often the counts are printed, if they have changed."""


def bridge(
    rules: Annotated[Path, typer.Argument(help="TOML file with two tables [sides.NAME] and [[rules]].")],
    connect: ConnectOption = None,
) -> None:
    """Carry what the rules allow from one team to another, until Ctrl-C; nothing else passes."""
    from robrain.deploy.bridge.bridge import Bridge
    from robrain.deploy.bridge.bridge_rules import read_bridge
    from robrain.deploy.processes.live_process import LiveStop, open_when_there
    from robrain.protocol.wire.hub import team_endpoints

    given = read_bridge(rules)
    should_stop = LiveStop()
    with ExitStack() as stack:
        sessions = {}
        for name, side in given.sides.items():
            session = open_when_there("bridge", side.connect or team_endpoints(connect), should_stop)
            if session is None:
                return
            sessions[name] = stack.enter_context(closing(session))
        joint = stack.enter_context(closing(Bridge(given, sessions)))
        waiting = threading.Event()
        joint.on_waiting(waiting.set)
        sides = " and ".join(f"{name} (team {side.team})" for name, side in given.sides.items())
        say(f"bridge: {sides}; Ctrl-C ends it")
        told, told_s = "", time.monotonic()
        while not should_stop():
            waiting.clear()
            joint.step()
            if time.monotonic() - told_s > TELL_S:
                told, told_s = _tell(joint.counts, told), time.monotonic()
            waiting.wait(LOOK_S)
        joint.step()
        counts = joint.counts
    _tell(counts, "")


def _tell(counts: "dict[str, Counts]", before: str) -> str:
    """Print the counts if they are not those of before; returns them as text."""
    text = "".join(f"bridge: {way}: {msgspec.json.encode(count).decode()}\n" for way, count in counts.items())
    if text != before:
        sys.stderr.write(text)
        sys.stderr.flush()
    return text
