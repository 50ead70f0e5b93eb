"""`robrain metrics` serves a live team's metrics on loopback."""

import re
import urllib.request

import pytest

from tests.waiting import until

pytestmark = pytest.mark.system


def test_metrics_of_a_live_robot_are_scraped(commands) -> None:
    arena = commands.start("arena", "arena_small", "--robots", "1", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    endpoint = commands.line_with(arena, "arena: arena_small at ").split(" at ")[1].split(",")[0]
    commands.line_with(commands.start("agent", "r1.toml"), "agent: r1 is up")
    metrics = commands.start("metrics", "--connect", endpoint, "--port", "0")
    url = commands.line_with(metrics, "metrics: of team default at ").rpartition(" at ")[2].strip()
    assert url.startswith("http://127.0.0.1:")

    def scraped() -> str:
        with urllib.request.urlopen(url) as reply:
            return str(reply.read().decode())

    for line in (
        r'robrain_robot_up{robot="r1"} 1.0',
        r'robrain_robot_soc_ratio{robot="r1"} 0\.\d+',
        r'robrain_messages_total{topic="robot_state"} [1-9]',
        r'robrain_plugin_restarts_total{plugin="driver",robot="r1"} 0.0',
    ):
        until(lambda line=line: re.search(line, scraped()), f"no {line}")
