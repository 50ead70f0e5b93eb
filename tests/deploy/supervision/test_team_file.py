"""Team files: what is in them, and what is said of a wrong one."""

from pathlib import Path

import pytest

from robrain.deploy.errors import UsageError
from robrain.deploy.supervision.team_file import is_team_file, read_team_file

GOOD = """
[team]
name = "blue"
scenario = "depot"
port = 7000

[[hosts]]
name = "base"
address = "10.0.0.5"
parts = ["hub", "arena", "coordinator", "stand-by", "recorder", "dashboard"]

[[hosts]]
name = "cart"
address = "cart.local"
parts = ["r1", "r2"]
"""
REAL = """
[robots]
r1 = "r1.toml"

[[hosts]]
name = "base"
address = "127.0.0.1"
parts = ["hub", "coordinator", "r1"]
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "team.toml"
    path.write_text(text)
    return path


def test_hosts_and_the_hubs_endpoint_are_read(tmp_path) -> None:
    path = written(tmp_path, GOOD)
    found = read_team_file(path)
    assert found.endpoint == "tcp/10.0.0.5:7000"
    assert not found.is_private
    assert found.host(path, "cart").robots == ["r1", "r2"]
    assert found.host(path, "base").robots == []


def test_planning_file_that_is_missing_is_told(tmp_path) -> None:
    (tmp_path / "r1.toml").write_text('[robot]\nname = "r1"\n')
    with pytest.raises(UsageError, match=r"team\.planning: expected a file"):
        read_team_file(written(tmp_path, f'[team]\nplanning = "gone.toml"\n{REAL}'))


def test_only_host_needs_no_name(tmp_path) -> None:
    (tmp_path / "r1.toml").write_text('[robot]\nname = "r1"\n')
    path = written(tmp_path, REAL)
    found = read_team_file(path)
    assert found.host(path, None).name == "base"
    assert found.endpoint == "tcp/127.0.0.1:7447"
    assert found.is_private


def test_ipv6_address_stands_in_brackets(tmp_path) -> None:
    found = read_team_file(written(tmp_path, GOOD.replace("10.0.0.5", "fd00::5")))
    assert found.endpoint == "tcp/[fd00::5]:7000"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("10.0.0.5", "10.0.0.5:7447", "hosts[0]: address: expected an IP address or a host name, got '10.0.0.5:7447'"),
        ('"r1", "r2"', '"r1", "r1"', "hosts[1]: parts: expected r1 once"),
        ('"r1", "r2"', "", "hosts[1]: parts: expected at least one of hub, arena,"),
        ('"r1", "r2"', '"r1", "arena"', "hosts: expected arena on one host, got base, cart"),
        ('"r1", "r2"', '"r/1"', "hosts[1]: "),
        ('"cart"', '"base"', "hosts: expected each name once, got base 2 times"),
        ('"hub", ', "", "hosts: expected one with the part hub"),
        ('scenario = "depot"', "", "team.scenario: expected a scenario for the part arena"),
        ("7000", "70000", "team: expected port"),
        ("7000", '"7000"', "team.port: Expected `int`, got `str`"),
        ("port = 7000", 'rules = "x.toml"', "team: rules: expected none beside a scenario"),
        ("port = 7000", "prot = 7000", "team: unknown key `prot` (did you mean `port`?)"),
        ("[[hosts]]", "[[hosts", "is not TOML"),
        ('[team]\n', '[robots]\nr9 = "r9.toml"\n[team]\n', "robots.r9: expected a file"),
        ("[[hosts]]", "[[computers]]", "unknown key `computers`"),
    ],
)  # fmt: skip
def test_wrong_file_is_told_by_file_key_and_what_was_expected(tmp_path, old: str, new: str, said: str) -> None:
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(UsageError) as error:
        read_team_file(path)
    assert str(error.value).startswith(f"{path}: ")
    assert said in str(error.value)


def test_robot_without_scenario_needs_its_file(tmp_path) -> None:
    with pytest.raises(UsageError, match=r"expected the ROBOT\.toml of r1, as there is no scenario"):
        read_team_file(written(tmp_path, REAL.replace('r1 = "r1.toml"\n', "")))


@pytest.mark.parametrize(
    ("name", "said"), [(None, "expected --host with one of base, cart"), ("van", "--host van: expected one of base, ")]
)
def test_host_that_is_not_there_is_told_with_those_that_are(tmp_path, name: str | None, said: str) -> None:
    path = written(tmp_path, GOOD)
    with pytest.raises(UsageError, match=said):
        read_team_file(path).host(path, name)


def test_scenario_file_is_no_team_file(tmp_path) -> None:
    assert is_team_file(written(tmp_path, GOOD))
    assert not is_team_file(written(tmp_path, '[scenario]\nname = "x"\n'))
    assert not is_team_file(tmp_path / "none.toml")
    assert not is_team_file(written(tmp_path, "= ="))
