"""Base stations of a live arena over TCP: TinyOS' own tools could be the client, and so could a robot's plugin."""

import json
from functools import partial

import pytest

from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from tests.asking import until_answered
from tests.system.conftest import member_at
from tests.waiting import until

pytestmark = pytest.mark.system

MOTES = """
[scenario]
name = "near"
[floor]
size_m = [4.0, 4.0]
[team]
robots = 1
[motes]
count = 3
period_s = 0.5
jitter_s = 0.05
"""


def start_arena(commands):
    """A live arena with a robot among three motes: its hub's endpoint, and where the base station listens."""
    (commands.folder / "near.toml").write_text(MOTES)
    arena = commands.start("arena", "near.toml", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    address = commands.line_with(arena, "serial forwarder of r1: ").split(": ")[1].strip()
    endpoint = commands.line_with(arena, "arena: near at ").split(" at ")[1].split(",")[0]
    host, _, port = address.partition(":")
    return endpoint, host, int(port)


def test_a_robot_goes_by_its_base_station_s_forwarder(commands) -> None:
    endpoint, host, port = start_arena(commands)
    robot_file = commands.folder / "r1.toml"
    text = robot_file.read_text()
    assert f"# port = {port}" in text
    robot_file.write_text(text + f'\n[parameters.mote_base]\ninterface = "sf"\nhost = "{host}"\nport = {port}\n')
    commands.agents("r1")
    with member_at(endpoint) as wire:

        def told(plugin, function):
            ask = partial(wire.ask, ROBOT_CALL, [], robot="r1", plugin=plugin, function=function)
            return json.loads(until_answered(ask))

        def motes():
            try:
                return [row["mote"] for row in told("snw_exploration", "motes")]
            except CallError:  # its device may not be there yet
                return []

        until(lambda: motes() == ["m1", "m2", "m3"], "not all motes were heard", pause_s=0.2)
        counters = told("mote_base", "counters")
        assert counters["line"] == {"unsent": 0, "reconnects": 0}
