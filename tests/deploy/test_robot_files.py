from pathlib import Path

import msgspec
import pytest

from robrain import Scenario
from robrain.agent.host.robot_file import read_robot_file
from robrain.deploy.processes.robot_files import loadable_from_here, write_robot_files


@pytest.mark.parametrize(
    "endpoints",
    [
        ["tcp/0.0.0.0:7447"],  # any machine
        ["tcp/[::]:7447"],
        ["tcp/192.168.0.1:7447"],
        ["tcp/127.0.0.1:7447", "tcp/192.168.0.1:7447"],  # one of them is enough
        ["tcp/robot.local:7447"],  # a name may lead anywhere
        ["ws/127.0.0.1:7447"],  # not known to be private
        [],
    ],
)
def test_no_folder_is_open_where_others_could_ask(endpoints, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert loadable_from_here(endpoints) == []


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/localhost:0", "tcp/[::1]:7447", "tcp/127.1.2.3:1"])
def test_on_loopback_the_folder_of_the_start_is_open(endpoint, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert loadable_from_here([endpoint]) == [tmp_path]


def test_the_whole_disk_is_never_open(monkeypatch):
    monkeypatch.chdir("/")
    assert loadable_from_here(["tcp/127.0.0.1:7447"]) == []


def test_a_written_robot_file_opens_the_folders_that_it_was_given(tmp_path):
    world = Scenario.builtin("arena_small").replace(robots=1).world()
    (path,) = write_robot_files(world, tmp_path, team="t", connect="tcp/127.0.0.1:1", loadable=[tmp_path])
    assert read_robot_file(path).robot.loadable == [str(tmp_path)]
    (closed,) = write_robot_files(world, tmp_path, team="t", connect="tcp/127.0.0.1:1")
    assert "loadable" not in msgspec.toml.decode(Path(closed).read_bytes())["robot"]
