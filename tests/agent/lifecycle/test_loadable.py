"""Which folders a robot loads plugins from when a caller outside names a path."""

import os
from pathlib import Path

import pytest

from robrain.agent.errors import RobotFileError
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable, read_robot_file
from robrain.agent.lifecycle import plugin_folders
from robrain.protocol.clock import VirtualClock
from robrain.protocol.errors import ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_LOAD, LoadRequest
from robrain.protocol.wire.endpoint import Drive
from tests.agent.conftest import refused

LAMP = "from robrain.agent.plugin import Unit\n\nclass Lamp(Unit):\n    pass\n"
MANIFEST = '[plugin]\nclass = "lamp:Lamp"\n'


def write_lamp(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "lamp.py").write_text(LAMP)
    (folder / "lamp.toml").write_text(MANIFEST)
    return folder


@pytest.fixture
def disk(tmp_path) -> Path:
    """Folders `place`, `open` and `closed`, each with a plugin `lamp` in a folder of its own."""
    for name in ("open", "closed"):
        write_lamp(tmp_path / name / "lamp")
    (tmp_path / "place").mkdir()
    return tmp_path


@pytest.fixture
def load(bench, disk):
    """Ask the robot to load a path; returns the names of the loaded plugins."""
    table = RobotTable("r1", places=["place"], loadable=["open"], load=[])
    host = AgentHost(RobotFile(robot=table), disk, bench.session, VirtualClock(), Drive.LOCKSTEP)
    bench.hosts.append(host)
    host.start()

    def ask(path: Path | str) -> list[str]:
        return [info.name for info in bench.wire.ask(HOST_LOAD, LoadRequest(plugin=str(path)), robot="r1")]

    return ask


def code_of(load, path: Path | str) -> tuple[ErrorCode, str]:
    error = refused(load, path)
    return error.code, str(error)


@pytest.mark.parametrize("asked", ["open", "open/lamp", "open/lamp/lamp.toml", "closed/../open/lamp", "link/lamp"])
def test_a_path_in_a_folder_that_the_robot_opens_is_loaded(load, disk, asked):
    (disk / "link").symlink_to(disk / "open")
    assert "lamp" in load(disk / asked)


@pytest.mark.parametrize(
    "asked",
    [
        "closed",
        "closed/lamp/lamp.toml",
        "open/../closed/lamp",  # leaves the open folder again
        "open/link/lamp",  # a link in an open folder to one that is not
        "open/lamp/linked.toml",  # the same for a manifest
        "open2/lamp",  # shares only a prefix of the name
        "..",
        "nowhere/at/all",  # nothing is there: the answer is the same
        "/etc/passwd",
        "/proc/self/root",
    ],
)
def test_a_path_elsewhere_is_refused_whether_or_not_something_is_there(load, disk, asked):
    (disk / "open" / "link").symlink_to(disk / "closed")
    (disk / "open" / "lamp" / "linked.toml").symlink_to(disk / "closed" / "lamp" / "lamp.toml")
    write_lamp(disk / "open2" / "lamp")
    path = str(disk / asked)
    code, text = code_of(load, path)
    assert code is ErrorCode.FORBIDDEN
    assert text == f"{path} is outside the folders this robot loads plugins from; add its folder to [robot] loadable"


def test_a_folder_with_a_manifest_that_leads_elsewhere_is_refused(load, disk):
    (disk / "open" / "lamp" / "linked.toml").symlink_to(disk / "closed" / "lamp" / "lamp.toml")
    assert code_of(load, disk / "open")[0] is ErrorCode.FORBIDDEN


def test_a_relative_path_starts_at_the_working_folder_and_is_confined_too(load, disk, monkeypatch):
    monkeypatch.chdir(disk / "open")
    assert code_of(load, "../closed/lamp")[0] is ErrorCode.FORBIDDEN
    assert "lamp" in load("./lamp")


@pytest.mark.parametrize("asked", ["ghost", "", "x" * 4000, "lamp"])
def test_an_unknown_name_is_answered_with_the_known_names(load, disk, monkeypatch, asked):
    monkeypatch.chdir(disk / "closed")  # has a folder of that name
    code, text = code_of(load, asked)
    assert code is ErrorCode.UNKNOWN_PLUGIN
    assert "driver" in text or "no plugin there" in text
    assert len(text) < 2000


@pytest.mark.parametrize("asked", ["a\0b/c", "\ud800/x", "/" + "x" * 300 + "/y", "x/" * 1500])
def test_an_invalid_path_is_refused(load, asked):
    try:
        code, text = code_of(load, asked)
    except UnicodeEncodeError:  # cannot even be sent
        return
    assert code in (ErrorCode.UNKNOWN_PLUGIN, ErrorCode.FORBIDDEN)
    assert len(text) < 400


def test_links_in_a_circle_are_refused(load, disk):
    (disk / "open" / "a").symlink_to(disk / "open" / "b")
    (disk / "open" / "b").symlink_to(disk / "open" / "a")
    assert code_of(load, disk / "open" / "a" / "x")[0] in (ErrorCode.UNKNOWN_PLUGIN, ErrorCode.FORBIDDEN)


def test_a_pipe_named_like_a_manifest_does_not_hold_the_robot(load, disk):
    os.mkfifo(disk / "open" / "pipe.toml")
    assert "lamp" in load(disk / "open")


def test_a_folder_with_too_much_in_it_is_not_looked_through(load, disk, monkeypatch):
    monkeypatch.setattr(plugin_folders, "MOST_FILES", 10)
    for number in range(10):
        (disk / "open" / f"note{number}").touch()
    code, text = code_of(load, disk / "open")
    assert code is ErrorCode.UNKNOWN_PLUGIN
    assert text == "more than 10 files are in that folder: name the plugin's own folder"
    assert "lamp" in load(disk / "open" / "lamp")


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("lamp.toml", "[plugin"),  # no TOML
        ("lamp.toml", '[plugin]\nclass = "lamp:Lamp"\nodd = 1\n'),  # an unknown key
        ("lamp.toml", '[plugin]\nclass = "lamp:Lamp"\n[tag]\nrequires = ["ghost"]\n'),
        ("lamp.py", "class Lamp: pass"),
        ("lamp.py", "1 / 0"),
        ("lamp.py", LAMP.replace("pass", "def init(self): open('/nowhere/at/all')")),
    ],
)
def test_a_refusal_does_not_say_where_the_robot_keeps_its_files(load, disk, file, content):
    (write_lamp(disk / "place" / "lamp") / file).write_text(content)
    _, text = code_of(load, "lamp")
    assert str(disk) not in text


def test_a_robot_file_opens_folders_beside_it_and_at_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for folder in ("home/mine", "beside"):
        (tmp_path / folder).mkdir(parents=True)
    path = tmp_path / "r1.toml"
    path.write_text('[robot]\nname = "r1"\nloadable = ["~/mine", "beside"]\n')
    assert read_robot_file(path).robot.loadable == ["~/mine", "beside"]
    path.write_text('[robot]\nname = "r1"\nloadable = ["~/yours"]\n')
    with pytest.raises(RobotFileError, match=r"robot\.loadable: expected a folder, .*/home/yours is not one"):
        read_robot_file(path)
