"""Measurements of robrain itself give their figures, and leave no process behind."""

import pytest

from robrain.lab.bench.figure import FigureKind
from robrain.sim.scenarios.scenario import Scenario
from tests.bench import agents, consensus, live_mapping, responses

pytestmark = pytest.mark.system


def test_a_team_without_coordinator_is_measured_beside_optimal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consensus, "OPTIMAL_ITERATIONS", 200)
    found = list(consensus.measure(((3, 15, 1.0),), [1]))
    assert all(figure.kept is not False for figure in found)
    assert {figure.kind for figure in found} == {FigureKind.DETERMINISTIC}
    gaps = [figure.value for figure in found if "gap" in figure.name]
    assert len(gaps) == 3
    assert min(gaps) < max(gaps)


def test_responses_of_a_live_robot_are_measured() -> None:
    found = list(responses.measure(1))
    assert len(found) == 14
    assert all(figure.value > 0 for figure in found if "turn of a wheel" in figure.name)
    assert {figure.kind for figure in found} == {FigureKind.TIMING}


def test_agents_on_the_wire_are_counted_by_a_real_coordinator(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agents, "SETTLING_S", 1.0)
    cpu, age, unseen, memory = agents.measure(2, 0.02)
    assert cpu.unit == "%"
    assert age.value > 0
    assert unseen.value >= 0
    assert memory.unit == "MB"


def test_stopped_agents_of_a_live_team_are_compared_with_an_undisturbed_team(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_mapping, "PER_MINUTE", 40.0)
    scenario = Scenario.builtin("arena_small").replace(robots=1, seed=1)
    words = ["arena_small", "--robots", "1", "--seed", "1"]
    found = {figure.name: figure for figure in live_mapping.measure(scenario, words, 0.15)}
    assert found["agents stopped: explored at the end"].value > 10
    worse = found["cells off at the end, agents stopped less undisturbed"]
    assert int(worse.beside.split()[0]) > 0  # stops
