import pytest

from robrain.agent.errors import RobotFileError
from robrain.agent.host.robot_file import read_robot_file

GOOD = """
[robot]
name = "r1"
team = "red"
places = ["plugins"]
load = ["driver"]

[zenoh]
connect = ["tcp/127.0.0.1:7447"]

[parameters.driver]
speed_m_s = 0.4
"""


@pytest.fixture
def write(tmp_path):
    (tmp_path / "plugins").mkdir()

    def write(text):
        path = tmp_path / "robot.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_robot_file_says_what_the_agent_needs_to_know(write):
    robot_file = read_robot_file(write(GOOD))
    assert (robot_file.robot.name, robot_file.robot.team) == ("r1", "red")
    assert robot_file.robot.places == ["plugins"]
    assert robot_file.robot.load == ["driver"]
    assert robot_file.zenoh.connect == ["tcp/127.0.0.1:7447"]
    assert robot_file.parameters == {"driver": {"speed_m_s": 0.4}}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('name = "r1"', "", "robot: Object missing required field `name`"),  # no name
        ("[robot]", "[rowboat]", "unknown table `rowboat`"),  # a slip of the pen in a table
        ("team =", "taem =", "robot: unknown key `taem` (did you mean `team`?)"),  # and in a key
        ('name = "r1"', 'name = "r/1"', "robot: bad robot name 'r/1': / may not"),  # a name that no key can hold
        ("tcp/127.0.0.1:7447", "127.0.0.1", "zenoh: '127.0.0.1' is not an endpoint"),  # no endpoint
        ("[zenoh]", '[zenoh]\nmode = "clint"', "zenoh.mode: unknown value 'clint' (did you mean `client`?)"),  # no mode
        ('["plugins"]', '["plugs"]', "robot.places: expected a folder"),  # no folder
        ("load =", "load = =", "is not TOML"),  # no TOML
    ],
)
def test_a_wrong_robot_file_is_refused_naming_file_and_key(write, old, new, expected):
    assert old in GOOD
    path = write(GOOD.replace(old, new))
    with pytest.raises(RobotFileError) as wrong:
        read_robot_file(path)
    assert str(wrong.value).startswith(f"{path}: ")
    assert expected in str(wrong.value)


def test_a_file_that_is_not_there_is_said_in_words(tmp_path):
    with pytest.raises(RobotFileError, match=r"robot.toml: there is no such file"):
        read_robot_file(tmp_path / "robot.toml")
