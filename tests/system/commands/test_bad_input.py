"""Bad input gives one clear sentence on stderr, exit status 2, no traceback, and leaves nothing half-written."""

import json
import socket

import pytest

pytestmark = pytest.mark.system

MAP = "image: {image}\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["run", "nosuch"], ["nosuch", "depot"]),  # no scenario of that name: those that there are
        (["run"], ["SCENARIO", "--map"]),  # neither scenario nor map
        (["run", "depot", "--map", "map.yaml"], ["SCENARIO", "--map"]),  # both
        (["run", "--map", "nosuch.yaml"], ["nosuch.yaml"]),  # missing map
        (["run", "missing.toml"], ["missing.toml", "no such"]),  # missing scenario file
        (["run", "depot", "--robots", "0"], ["--robots", "at least 1"]),
        (["run", "arena_small", "--robots", "900"], ["arena_small", "900", "fit"]),  # more robots than fit
        (["run", "depot", "--robots", "4000"], ["depot", "4000", "1000"]),  # more than the simulator takes
        (["run", "depot", "--until", "explored=2"], ["--until", "explored=FRACTION"]),
        (["run", "depot", "--until", "distance=2"], ["--until", "explored=FRACTION"]),
        (["run", "depot", "--speed", "-1"], ["--speed", "0"]),
        (["run", "depot", "--time-limit", "0"], ["--time-limit", "above 0"]),
        (["run", "arena_small", "--record", "nosuch/run.mcap"], ["nosuch"]),  # unwritable recording path
        (["run", "arena_small", "--record", "run.bag"], ["run.bag", ".mcap"]),
        (["run", "arena_small", "--record", "/proc/run.mcap"], ["/proc/run.mcap"]),  # without write permission
        (["replay", "nosuch.mcap"], ["nosuch.mcap"]),
        (["replay", "run.mcap", "--speed", "0"], ["--speed", "above 0"]),
        (["replay", "run.mcap", "--start", "nan"], ["--start", "0 or more"]),
        (["replay", "run.mcap", "--loop", "--team", "t"], ["--loop, --team", "--no-dashboard"]),
        (["agent", "nosuch.toml"], ["nosuch.toml", "no such file"]),
        (["coordinator", "--planning", "nosuch.toml"], ["--planning", "nosuch.toml", "no such file"]),
        (["status"], ["--connect", "ROBRAIN_CONNECT"]),
        (["status", "--connect", "tcp/127.0.0.1:9"], ["tcp/127.0.0.1:9", "nobody"]),
        (["status", "--connect", "localhost"], ["localhost", "tcp/127.0.0.1:7447"]),  # not an endpoint
        (["status", "--team", "a/b", "--connect", "tcp/127.0.0.1:9"], ["a/b", "team"]),
    ],
)
def test_bad_input_is_told_in_one_sentence(commands, words: list[str], named: list[str]) -> None:
    before = set(commands.folder.rglob("*"))
    line = commands.refused(*words)
    assert [text for text in named if text not in line] == []
    assert set(commands.folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ["scenario"]),  # empty file
        ("[scenario", ["TOML"]),
        ('[scenario]\nname = "x"\n', ["[floor] or [map]"]),
        ('[scenario]\nname = "x"\nspeed = 3\n[map]\nfile = "m.yaml"\n', ["speed"]),  # unknown key
        ('[scenario]\nname = "x"\nseed = "one"\n[map]\nfile = "m.yaml"\n', ["scenario.seed", "int"]),  # wrong type
        ('[scenario]\nname = "x"\n[team]\nrobots = 0\n[map]\nfile = "m.yaml"\n', ["team", "robots"]),
        ('[scenario]\nname = "x"\n[map]\nfile = "m.yaml"\n', ["m.yaml"]),  # missing map
    ],
)
def test_bad_scenario_file_is_named_with_its_key(commands, text: str, named: list[str]) -> None:
    (commands.folder / "mine.toml").write_text(text)
    line = commands.refused("run", "mine.toml")
    assert [word for word in named if word not in line] == []


def test_map_without_free_space_is_refused(commands) -> None:
    pixels = b"P5\n20 20\n255\n" + bytes(400)
    (commands.folder / "black.pgm").write_bytes(pixels)
    (commands.folder / "black.yaml").write_text(MAP.format(image="black.pgm"))
    assert "expected free space" in commands.refused("run", "--map", "black.yaml")
    (commands.folder / "black.pgm").write_bytes(b"")
    assert "black.pgm" in commands.refused("run", "--map", "black.yaml")


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


def test_existing_recording_is_not_overwritten(commands) -> None:
    path = commands.folder / "kept.mcap"
    path.write_bytes(b"precious")
    assert "exists already" in commands.refused("run", "arena_small", "--record", "kept.mcap")
    assert path.read_bytes() == b"precious"
