"""The scenarios that come with robrain, in a few words each."""

import msgspec

from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.scenarios.scenario_file import builtin_names


class ListedScenario(msgspec.Struct, frozen=True, kw_only=True):
    """One line of `robrain scenarios`."""

    name: str
    about: str
    """What it shows, in one sentence."""
    width_m: float
    """Of its floor, along x."""
    height_m: float
    """Of its floor, along y."""
    robots: int
    motes: int
    tasks: int
    """Number of tasks that the scenario itself submits."""


def listed_scenarios() -> list[ListedScenario]:
    """All of them, sorted by name (ScenarioError if one cannot be read)."""
    return [_listed(Scenario.builtin(name)) for name in builtin_names()]


def _listed(scenario: Scenario) -> ListedScenario:
    width_m, height_m = scenario.plan().size_m
    return ListedScenario(
        name=scenario.name,
        about=scenario.about,
        width_m=round(width_m, 3),
        height_m=round(height_m, 3),
        robots=scenario.robots,
        motes=scenario.motes,
        tasks=len(scenario.tasks),
    )
