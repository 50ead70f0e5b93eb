"""`robrain bench`: tables and JSON, public instances."""

import json
from pathlib import Path

import pytest

R101 = Path(__file__).parents[2] / "algorithms" / "allocation" / "data" / "R101_25.txt"
pytestmark = pytest.mark.system


def test_public_instance_is_solved_and_its_gap_told(commands, tmp_path: Path) -> None:
    file = tmp_path / "runs.json"
    done = commands.run_here("bench", "allocation", str(R101), "--seconds", "3", "--json", str(file))
    assert done.returncode == 0, done.stderr
    told = json.loads(file.read_text())
    (run,) = told["runs"]
    assert (run["robrain"]["customers"], run["robrain"]["left_out"]) == (25, 0)
    assert run["robrain"]["value"] <= 1.05 * 617.1, "the optimum"


def test_life_of_a_mote_field_is_told_with_its_bounds(commands, tmp_path: Path) -> None:
    file = tmp_path / "motes.json"
    done = commands.run_here("bench", "motes", "--seeds", "3", "--methods", "tree,routes,relief", "--json", str(file))
    assert done.returncode == 0, done.stderr
    assert "first dead d" in done.stdout
    told = json.loads(file.read_text())
    assert told["all_kept"]
    assert [run["case"]["method"] for run in told["runs"]] == ["tree", "routes", "relief"]
    assert len(told["figures"]) == 2
