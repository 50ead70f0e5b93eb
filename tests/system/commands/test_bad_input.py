"""Bad input gives one clear sentence on stderr, exit status 2, no traceback, and leaves nothing half-written."""

import json
import socket

import pytest

pytestmark = pytest.mark.system


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["run", "nosuch"], ["nosuch", "depot"]),  # no scenario of that name: those that there are
        (["run"], ["SCENARIO", "--map"]),  # neither scenario nor map
        (["run", "missing.toml"], ["missing.toml", "no such"]),  # missing scenario file
        (["run", "depot", "--robots", "0"], ["--robots", "at least 1"]),
        (["run", "arena_small", "--robots", "900"], ["arena_small", "900", "fit"]),  # more robots than fit
        (["run", "depot", "--until", "explored=2"], ["--until", "explored=FRACTION"]),
        (["run", "arena_small", "--record", "nosuch/run.mcap"], ["nosuch"]),  # unwritable recording path
        (["replay", "nosuch.mcap"], ["nosuch.mcap"]),
        (["replay", "run.mcap", "--loop", "--team", "t"], ["--loop, --team", "--no-dashboard"]),
        (["agent", "nosuch.toml"], ["nosuch.toml", "no such file"]),
        (["coordinator", "--planning", "nosuch.toml"], ["--planning", "nosuch.toml", "no such file"]),
        (["status", "--connect", "tcp/127.0.0.1:9"], ["tcp/127.0.0.1:9", "nobody"]),
        (["status", "--team", "a/b", "--connect", "tcp/127.0.0.1:9"], ["a/b", "team"]),
    ],
)
def test_bad_input_is_told_in_one_sentence(commands, words: list[str], named: list[str]) -> None:
    before = set(commands.folder.rglob("*"))
    line = commands.refused(*words)
    assert [text for text in named if text not in line] == []
    assert set(commands.folder.rglob("*")) == before


@pytest.mark.parametrize("name", ["r*", "r/1", "r#", "r$1", "r?", "", "@r"])
def test_robot_name_that_is_no_key_is_refused(commands, name: str) -> None:
    (commands.folder / "robot.toml").write_text(f"[robot]\nname = {json.dumps(name)}\n")
    line = commands.refused("agent", "robot.toml", "--connect", "tcp/127.0.0.1:9")
    assert "robot.toml" in line
    assert "name" in line


def test_taken_port_is_told(commands) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        for words in (("arena", "arena_small", "--listen", f"tcp/127.0.0.1:{port}"),
                      ("run", "arena_small", "--dashboard", "--port", str(port), "--time-limit", "1")):  # fmt: skip
            assert str(port) in commands.refused(*words)
