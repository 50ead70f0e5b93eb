"""The file that says how plans are made: read from a scenario or a file of its own, wrong ones named with their key."""

import pytest

from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.deploy.errors import UsageError
from robrain.deploy.processes.table_files import read_planning, write_planning
from robrain.protocol.model.tasks.objective import Objective


def test_what_is_written_is_read(tmp_path):
    policy = PlanningPolicy(
        objective=Objective.MAKESPAN, method="greedy", seed=7, deadline_s=0.3, reserve_share=0.25, tasks_max=12
    )
    assert read_planning(write_planning(tmp_path / "planning.toml", policy)) == policy
    assert read_planning(write_planning(tmp_path / "usual.toml", PlanningPolicy())) == PlanningPolicy()


def test_a_scenario_will_do_as_its_other_tables_are_not_looked_at(tmp_path):
    path = tmp_path / "depot.toml"
    path.write_text('[scenario]\nname = "depot"\n[planning]\nseed = 3\n')
    assert read_planning(path) == PlanningPolicy(seed=3)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[planning]\nseed = -1\n", ["planning", "seed >= 0", "-1"]),  # out of range
        (
            '[planning]\nmethod = "best"\n',
            ["planning: expected method to be one of", "got best"],
        ),  # none of the methods
        ('[planning]\ndeadline_s = "long"\n', ["planning.deadline_s", "float", "str"]),  # another type
        ("[planning]\nsead = 1\n", ["planning", "sead"]),  # misspelt key
        ("[planing]\nseed = 1\n", ["[planning]"]),  # misspelt table
        ("[planning\n", ["not TOML"]),
        ("", ["[planning]"]),
    ],
)
def test_a_wrong_file_is_told_in_one_sentence_with_its_name_and_key(tmp_path, text, named):
    path = tmp_path / "team.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as raised:
        read_planning(path)
    assert all(word in str(raised.value) for word in ["--planning", str(path), *named])
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there_or_no_text_is_told(tmp_path):
    with pytest.raises(UsageError, match=r"team\.toml: there is no such file"):
        read_planning(tmp_path / "team.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="cannot be read"):
        read_planning(tmp_path / "bytes.toml")
    with pytest.raises(UsageError, match="cannot be read"):
        read_planning(tmp_path)
