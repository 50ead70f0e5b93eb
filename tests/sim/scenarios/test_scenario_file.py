from pathlib import Path

import pytest

from robrain.sim.errors import ScenarioError
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import builtin_names, read_builtin, read_scenario_file

GOOD = '[scenario]\nname = "s"\n[floor]\nsize_m = [8.0, 6.0]\n[team]\nrobots = 2\n'
VISIT = '[[tasks]]\nkind = "visit"\nplace_m = [1, 1]\n'
DOOR = "[[doors]]\nfrom_m = [4.0, 1.4]\nto_m = [4.0, 2.6]\n"


def fault(kind: str, *more: str, robot: str = "r1") -> str:
    return "\n".join((f'[[faults]]\nrobot = "{robot}"\nkind = "{kind}"\nat_s = 2.0', *more)) + "\n"


# Text that is added to a good scenario; what the error says after the name of the file.
WRONG = {
    "no TOML": ("[scenario\n", "is not TOML"),
    "unknown table": ("[robot_team]\ncount = 3\n", "unknown table `robot_team`"),
    "unknown key": ("[radio]\ntransmit = 3\n", "radio: unknown key `transmit` (did you mean `transmit_dbm`?); there "),
    "floor and map": ('[map]\nfile = "map.yaml"\n', "expected either [floor] or [map]"),
    "no power": ("[radio]\ntransmit_dbm = 30.0\n", "radio: expected a transmit power of at most 10 dBm, got 30"),
    "no hardware": ("[[robots]]\nhardware = { lidar = { rys = 3 } }", "robots[0]: hardware.lidar: "),
    "two places": ("[[robots]]\nplace_m = [1, 1]\nnear_m = [1, 1]", "robots[0]: expected either place_m or near_m"),
    "a yaw alone": ("[[robots]]\nyaw_rad = 1.0", "robots[0]: expected a finite yaw_rad, and only with place_m"),
    "without what": ('[[robots]]\nwithout = ["lidar"]', "robots[0]: no plugin lidar; there are "),
    "plugin": ("[[robots]]\n[robots.plugins.drive]", "robots[0]: no plugin drive; there are "),
    "relay": ('[[tasks]]\nkind = "relay"\nplace_m = [1, 1]', "tasks[0]: a task to relay needs duration_s"),
    "parameter": (f"{VISIT}parameters = {{ mote = 1 }}", "tasks[0]: a task to visit has no mote"),
    "after": (f'{VISIT}after = ["x"]', "tasks[0].after: no task x; there are visit-1"),
    "a name twice": (2 * f'{VISIT}name = "x"\n', "tasks[1]: expected each name once, got x twice"),
    "a circle": (
        f'{VISIT}after = ["visit-2"]\n{VISIT}after = ["visit-1"]',
        "tasks: visit-1 and visit-2 wait for each other",
    ),
    "no group": ("[[links.partitions]]\ngroups = []", "links.partitions[0]: expected groups with at least one name"),
    "in two groups": (
        '[[links.partitions]]\ngroups = [["r1"], ["r2", "r1"]]',
        "links.partitions[0]: expected each name in one of the groups, got 'r1' twice",
    ),
    "no interval": (
        '[[links.partitions]]\nfrom_s = 5\nuntil_s = 5\ngroups = [["r1"]]',
        "links.partitions[0]: expected until_s above from_s, 5, got 5",
    ),
    "carried to nowhere": (fault("carried_off"), "faults[0]: expected place_m for carried_off"),
    "carried back": (fault("carried_off", "place_m = [1, 1]", "until_s = 3.0"), "faults[0]: expected no until_s"),
    "it ends before it begins": (fault("kill", "until_s = 1.0"), "faults[0]: expected until_s > at_s = 2"),
    "slow without a period": (fault("slow"), "faults[0]: expected period_s for slow"),
    "late before it is sent": (fault("delay", "late_s = [-1.0, 2.0]"), "faults[0]: expected late_s as"),
    "a side of a kill": (fault("kill", 'side = ["r2"]'), "faults[0]: expected side for partition alone"),
    "a disk of a robot": (fault("disk_full"), "faults[0]: expected robot = 'coordinator' for disk_full, got 'r1'"),
    "a battery of the coordinator": (
        fault("drain", "soc = 0.1", robot="coordinator"),
        "faults[0]: expected the name of a robot",
    ),
    "a delay of an agent": ("[disturbance.agent]\nduration_s = [1.0, 0.5]", "disturbance.agent: expected duration_s"),
    "doors without timetable": (DOOR, "doors[0]: expected one of open_s, period_s and opening_s"),
    "no order": (f"{DOOR}open_s = [[3, 5], [4, 6]]", "doors[0]: expected open_s as intervals in order"),
    "one point": ("[[movers]]\nvia_m = [[1, 1]]", "movers[0]: expected at least two points in via_m, got 1"),
    "one place": ("[[people]]\nplaces_m = [[1, 1]]", "people[0]: expected at least two places_m, got 1"),
    "no charge": ("[robot.battery]\ncharge_v = 11.0", "robot.battery: expected charge_v above cut_off_v"),
}


@pytest.mark.parametrize(("text", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_scenario_is_refused_in_one_sentence_with_file_and_key(text, expected):
    with pytest.raises(ScenarioError) as error:
        Scenario.from_toml(GOOD + text, "mine.toml")
    assert str(error.value).startswith(f"mine.toml: {expected}")
    assert "\n" not in str(error.value)


# What is right by itself, but not on this floor or in this team.
IMPOSSIBLE = {
    "a place in a wall": ("[[robots]]\nplace_m = [0.1, 1]", "expected room for r1, of radius 0.2 m, at x 0.1, y 1"),
    "a place twice": (2 * "[[robots]]\nplace_m = [1, 1]\n", "expected room for r2, of radius 0.2 m, at x 1, y 1 on s"),
    "a relay": ('[links]\nrelays = ["r9"]', "links: relays: no party 'r9'; there are coordinator and r1 to r2"),
    "a party": ('[[links.partitions]]\ngroups = [["m3"]]', "links: partitions: no party 'm3'; there are coordinator"),
    "a gateway": ('[motes]\ngateways = ["m99"]', "motes: gateways: no robot or mote 'm99'; there are robots r1"),
    "killed": (fault("kill", robot="r9"), "faults: no robot 'r9'; there are coordinator, r1 to r2"),
    "cut": (fault("can_cut", robot="r9"), "faults: no robot 'r9'; there are r1 to r2"),
    "carried into a wall": (fault("carried_off", "place_m = [0, 0]"), "faults: expected room for a robot"),
    "a charger": ("[[chargers]]\nplace_m = [0.1, 2]", "expected room for a robot of radius 0.2 m at the charger"),
    "a door": (f"{DOOR.replace('4.0, 1.4', '14.0, 1.4')}open_s = []", "expected doors[0].from_m on the floor"),
    "a mover": ("[[movers]]\nvia_m = [[2, 2], [2, 5.9]]", "expected movers[0].via_m clear of walls by 0.3 m, got 2, 2"),
    "a person": ("[[people]]\nplaces_m = [[2, 2], [2, 5.9]]", "expected room for people[0] at 2, 5.9"),
    "too many robots": ("", "9 robots"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_a_place_or_party_that_a_world_lacks_is_refused(text, expected):
    good = GOOD if text else GOOD.replace("8.0, 6.0", "1.5, 1.5").replace("= 2", "= 9")
    with pytest.raises(ScenarioError) as error:
        Scenario.from_toml(good + text).world()
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("robots", [0, 1001])
def test_a_number_of_robots_that_is_none_is_refused_in_a_script_too(robots):
    with pytest.raises(ScenarioError, match=f"arena_small: expected robots [<>]= 10*, got {robots}"):
        Scenario.builtin("arena_small").replace(robots=robots).run()


def test_files_that_cannot_be_read_are_named(tmp_path: Path):
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    for path, expected in (
        ("nothing.toml", "there is no such file"),
        ("", "cannot be read"),
        ("bytes.toml", "cannot be read"),
    ):
        with pytest.raises(ScenarioError, match=expected):
            read_scenario_file(tmp_path / path)


@pytest.mark.parametrize("name", builtin_names())
def test_each_built_in_scenario_bears_the_name_of_its_file(name):
    tables, text = read_builtin(name)
    assert tables.scenario.name == name
    assert name in text


def test_an_unknown_name_is_answered_with_those_that_there_are():
    with pytest.raises(ScenarioError, match="no scenario 'depo': built in are arena_small, cave, depot, hospital"):
        read_builtin("depo")
