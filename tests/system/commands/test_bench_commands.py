"""`robrain bench`: what there is, tables and JSON, public instances, live measurements that leave no process behind."""

import json
from pathlib import Path

import pytest

from robrain.lab.bench import agents
from robrain.lab.bench.allocation import consensus
from robrain.lab.bench.mapping import live_mapping

R101 = Path(__file__).parents[2] / "algorithms" / "allocation" / "data" / "R101_25.txt"
pytestmark = pytest.mark.system


def test_the_benchmarks_that_there_are_are_listed(commands) -> None:
    done = commands.run_here("bench", "--list")
    assert done.returncode == 0, done.stderr
    names = "allocation consensus responses agents exploration leaderless motes mapping joining live log"
    assert " ".join(line.split()[0] for line in done.stdout.splitlines()) == names


def test_public_instance_is_solved_and_its_gap_told(commands) -> None:
    done = commands.run_here(
        "bench", "allocation", "--instance", str(R101), "--best", "617.1", "--seconds", "3", "--json"
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["customers"], told["over_capacity"], told["left_out"]) == (25, 0, 0)
    assert 0.0 <= told["gap"] < 0.05


def test_value_of_a_public_instance_is_told_in_words_too(commands) -> None:
    done = commands.run_here("bench", "allocation", "--instance", str(R101), "--seconds", "1")
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first.startswith("R101: 25 customers, ")
    assert second.endswith("best known –")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["allocation", "--instance", "gone.vrp"], ["gone.vrp", "No such file"]),
        (["allocation", "--instance", str(R101), "--seconds", "0"], ["--seconds 0", "above 0"]),
        (["allocation", "--instance", str(R101), "--best", "-1"], ["--best -1", "above 0"]),
        (["allocation", "--best", "3"], ["--best", "--instance"]),
        (["allocation", "--sizes", "9"], ["--sizes 9", "1 to 3"]),
        (["consensus", "--sizes", "3"], ["--sizes 3", "1 to 2"]),
        (["consensus", "--seeds", "0"], ["--seeds 0", "at least 1"]),
        (["responses", "--rounds", "0"], ["--rounds 0", "at least 1"]),
        (["agents", "--robots", "0"], ["--robots 0", "at least 1"]),
        (["agents", "--minutes", "0"], ["--minutes 0", "above 0"]),
        (["mapping", "--maps", "moon"], ["--maps moon", "clinic"]),
        (["mapping", "--maps", "clinic", "--jobs", "0"], ["--jobs 0", "at least 1"]),
        (["mapping", "--maps", "clinic", "--conditions", "fog"], ["--conditions fog", "usual or glass or late"]),
        (["leaderless", "--killed-at", "95"], ["--killed-at 95", "below 95"]),
        (["leaderless", "--maps", "moon"], ["--maps moon", "clinic"]),
        (["leaderless", "--jobs", "0"], ["--jobs 0", "at least 1"]),
        (["motes", "--ways", "wind"], ["--ways wind", "tree or routes"]),
        (["motes", "--motes", "0"], ["--motes 0", "1 to 1000"]),
        (["motes", "--jobs", "0"], ["--jobs 0", "at least 1"]),
        (["motes", "--goal-days", "0"], ["--goal-days 0", "above 0"]),
        (["motes", "--motes", "8", "--ways", "tree", "--seeds", "1"], ["--motes 8", "take more"]),
        (["live", "--minutes", "0"], ["--minutes 0", "above 0"]),
        (["live", "--map", "gone.yaml"], ["gone.yaml", "there is none"]),
        (["live", "--map", "depot", "--robots", "0"], ["robots from 1"]),
        (["log", "gone.clf"], ["gone.clf", "No such file"]),
    ],
)
def test_bad_words_are_told_in_one_sentence(commands, words: list[str], named: list[str]) -> None:
    done = commands.run_here("bench", *words)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    for text in named:
        assert text in done.stderr


def test_life_of_a_mote_field_is_told_with_its_bounds(commands, tmp_path: Path) -> None:
    file = tmp_path / "motes.json"
    done = commands.run_here("bench", "motes", "--seeds", "3", "--ways", "tree,routes,relief", "--json", str(file))
    assert done.returncode == 0, done.stderr
    assert "first dead d" in done.stdout
    told = json.loads(file.read_text())
    assert told["all_kept"]
    assert [run["case"]["way"] for run in told["runs"]] == ["tree", "routes", "relief"]
    assert len(told["figures"]) == 2


def test_a_team_without_coordinator_is_measured_beside_optimal(commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consensus, "SIZES", ((3, 15, 1.0),))
    monkeypatch.setattr(consensus, "OPTIMAL_ITERATIONS", 200)
    done = commands.run_here("bench", "consensus", "--sizes", "1", "--seeds", "1", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["all_kept"]
    assert {figure["kind"] for figure in told["figures"]} == {"deterministic"}
    gaps = {figure["name"]: figure["value"] for figure in told["figures"] if "gap" in figure["name"]}
    assert len(gaps) == 3
    assert min(gaps.values()) < max(gaps.values())


def test_responses_of_a_live_robot_are_measured(commands) -> None:
    done = commands.run_here("bench", "responses", "--rounds", "1", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert len(told["figures"]) == 14
    assert all(figure["value"] > 0 for figure in told["figures"] if "turn of a wheel" in figure["name"])
    assert {figure["kind"] for figure in told["figures"]} == {"timing"}


def test_agents_on_the_wire_are_counted_by_a_real_coordinator(commands, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agents, "SETTLING_S", 1.0)
    done = commands.run_here("bench", "agents", "--robots", "2", "--minutes", "0.02", "--json")
    assert done.returncode == 0, done.stderr
    cpu, age, unseen, memory = json.loads(done.stdout)["figures"]
    assert cpu["unit"] == "%"
    assert age["value"] > 0
    assert age["bound"] == {"at_most": 200.0}
    assert unseen["value"] >= 0
    assert memory["unit"] == "MB"


def test_stopped_agents_of_a_live_team_are_compared_with_an_undisturbed_team(
    commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_mapping, "PER_MINUTE", 40.0)
    done = commands.run_here("bench", "live", "--map", "arena_small", "--robots", "1", "--minutes", "0.15", "--json")
    assert done.returncode == 0, done.stderr
    found = {figure["name"]: figure for figure in json.loads(done.stdout)["figures"]}
    assert found["agents stopped: explored at the end"]["value"] > 10
    worse = found["cells off at the end, agents stopped less undisturbed"]
    assert worse["bound"] == {"at_most": 2.0}
    assert int(worse["beside"].split()[0]) > 0  # stops
