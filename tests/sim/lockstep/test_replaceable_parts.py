"""A run whose strategy, allocator, pass or plugin fails ends with the line of its file; nothing stands in for it."""

import inspect
import re

import msgspec
import pytest

from robrain.algorithms.allocation.validate import validate
from robrain.coordinator.planning.plan_search import PlanSolver
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.registry import UnknownEntry
from robrain.sim.errors import RunFailed
from robrain.sim.scenarios.scenario import Scenario
from robrain.sim.world.scenario_tasks import TaskSpec
from tests.coordinator.planning.test_plan_solver import job, problem
from tests.installed_distributions import install  # noqa: F401 - a fixture

PARTS = """
import math

from robrain.algorithms.allocation.auction import AuctionAllocator
from robrain.algorithms.exploration.strategies import joint


def raises(_):
    return helper({})


def helper(known):
    return known["b"]


def nothing(_):
    pass




def unknown_robot(situation):
    return [choice._replace(robot="r99") for choice in joint(situation)]




def nan_cost(situation):
    return [choice._replace(cost_m=math.nan) for choice in joint(situation)]




def bare_place(situation):
    return [choice._replace(place=(choice.place.x_m, choice.place.y_m)) for choice in joint(situation)]


class NotMade:
    def __init__(self, objective):
        raise RuntimeError("no licence")


class Raises:
    def __init__(self, objective):
        self.objective = objective

    def plan(self, problem, **_):
        return problem.jobs[99]


class Nothing(Raises):
    def plan(self, problem, **_):
        return None


class Nan(AuctionAllocator):
    def plan(self, problem, **given):
        import msgspec

        return msgspec.structs.replace(super().plan(problem, **given), cost_j=math.nan)


class BadSearch(AuctionAllocator):
    def search(self):
        return Raises(self.objective)


def keeps(draft):
    return draft


def draws(draft):
    return draft.with_plan("a plan")
"""
FLOOR = """
[scenario]
name = "room"
time_limit_s = 2.0
[floor]
size_m = [8.0, 6.0]
walls = [{ from_m = [5.0, 0.0], to_m = [5.0, 2.2] }, { from_m = [5.0, 3.6], to_m = [5.0, 6.0] }]
[team]
robots = 2
near_m = [3.0, 3.0]
"""
TASKS = tuple(TaskSpec(kind="visit", place_m=(x_m, 2.0)) for x_m in (1.0, 2.5))
BAD = {
    "exploration": {
        "raises": "parts.py:{helper+1} in helper: KeyError: 'b'",
        "nothing": "parts.py:{nothing}: TypeError: expected a list of Choice, got NoneType",
        "unknown_robot": "r99 is not idle",
        "nan_cost": "expected a finite cost_m for r1, got nan",
        "bare_place": "to be a Point2D, got tuple",
    },
    "method": {
        "NotMade": "in __init__: RuntimeError: no licence",
        "Raises": "in plan: IndexError",
        "Nothing": "TypeError: expected a Plan, got NoneType",
        "Nan": "cost_j is",
        "BadSearch": "in plan: IndexError",
    },
    "passes": {
        "raises": "parts.py:{helper+1} in helper: KeyError: 'b'",
        "nothing": "parts.py:{nothing}: TypeError: expected a PlanDraft, got NoneType",
        "draws": "parts.py:{draws}: AttributeError: 'str' object has no attribute 'objective'",
    },
}
IN_FULL = [("exploration", "raises"), ("method", "BadSearch"), ("passes", "nothing")]


def line_of(name: str) -> int:
    return next(number for number, line in enumerate(PARTS.splitlines(), 1) if line.startswith(f"def {name}("))


@pytest.fixture
def parts(tmp_path):
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "room.toml").write_text(FLOOR)
    room = Scenario.from_file(tmp_path / "room.toml").replace(tasks=TASKS)

    def scenario(key: str, name: str, where: str = "parts.py") -> Scenario:
        part = f"{tmp_path}/{where}:{name}"
        policy = msgspec.structs.replace(PlanningPolicy(), **{key: (part,) if key == "passes" else part})
        return room.replace(planning=policy)

    return scenario


def check(key: str, name: str, failed: str) -> None:
    """The text names the part, the line of its file, and what is wrong."""
    expected = BAD[key][name].replace("{helper+1}", str(line_of("helper") + 1))
    for known in ("nothing", "draws"):
        expected = expected.replace(f"{{{known}}}", str(line_of(known)))
    assert expected in failed
    assert re.search(r"parts\.py:\d+", failed)


@pytest.mark.slow
@pytest.mark.parametrize(("key", "name"), IN_FULL)
def test_a_run_ends_with_the_failure_of_its_part(parts, key, name):
    with pytest.raises(RunFailed, match=f"parts.py:{name} failed: ") as failed:
        parts(key, name).run()
    check(key, name, str(failed.value).partition("failed: ")[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD["exploration"])
def test_points_end_with_the_failure_of_their_strategy(parts, name):
    with pytest.raises(RunFailed, match=f"parts.py:{name} failed: ") as failed:
        parts("exploration", name).replace(fidelity="points").run()
    check("exploration", name, str(failed.value).partition("failed: ")[2])


@pytest.mark.parametrize(("key", "name"), [(key, name) for key in ("method", "passes") for name in BAD[key]])
def test_the_stock_part_stands_in_while_a_live_team_plans(parts, key, name):
    policy = parts(key, name).planning
    solver = PlanSolver(problem(job("a", 1), job("b", 2)), policy)
    list(solver.improve())
    assert validate(solver.problem, solver.plan) == []
    assert sum(map(len, solver.plan.orders)) == 2
    (failure, *_) = solver.failures
    check(key, name, failure.reason)


@pytest.mark.slow
def test_parts_of_a_file_that_keep_their_promise_run_to_the_end(parts):
    policies = [parts(key, name).planning for key, name in (("exploration", "joint"), ("passes", "keeps"))]
    planning = msgspec.structs.replace(policies[0], passes=policies[1].passes)
    assert parts("method", "AuctionAllocator").replace(planning=planning).run().sim_time_s > 1.9


@pytest.mark.parametrize(
    ("text", "name", "said"),
    [
        ("", "f", "mine.py has no function f"),
        ("f = 3", "f", "mine.py has no function f"),
        ("def f(:\n", "f", "mine.py:1: SyntaxError"),
        ("import nowhere_at_all", "f", "mine.py:1 in <module>: ModuleNotFoundError"),
        (None, "f", "there is no file "),
    ],
)
def test_a_part_that_cannot_be_imported_is_refused_before_the_run(parts, tmp_path, text, name, said):
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    with pytest.raises(UnknownEntry, match=said):
        parts("method", name, "mine.py").run()


def test_a_part_may_import_from_its_folder(parts, tmp_path):
    (tmp_path / "beside_it.py").write_text("from robrain.algorithms.exploration.strategies import joint\n")
    (tmp_path / "mine.py").write_text("from beside_it import joint as mine\n")
    assert parts("exploration", "mine", "mine.py").planning.import_parts() is None


def test_a_scenario_file_names_a_part_beside_it(tmp_path):
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "room.toml").write_text(FLOOR + '[planning]\nexploration = "parts.py:joint"\n')
    planning = Scenario.from_file(tmp_path / "room.toml").planning
    assert planning.exploration == f"{tmp_path}/parts.py:joint"


PLUGIN = """
from robrain.agent.plugin import Skill


class Lamp(Skill):
    period_s = 0.1

    def init(self):
        {init}

    def step(self):
        {step}
"""
MANIFEST = '[plugin]\nclass = "lamps.lamp:Lamp"\n'


@pytest.mark.slow
@pytest.mark.parametrize(
    ("init", "step", "said"),
    [
        ("pass", "[][0]", "plugin lamp failed: lamps/lamp.py:12 in step: IndexError"),
        ("1 / 0", "pass", "plugin lamp failed: lamps/lamp.py:9 in init: ZeroDivisionError"),
    ],
)
def test_a_run_ends_with_the_failure_of_an_installed_plugin(parts, install, init, step, said):  # noqa: F811
    code = inspect.cleandoc(PLUGIN).format(init=init, step=step)
    files = {"lamps/__init__.py": "", "lamps/lamp.py": "\n" + code, "lamps/lamp.toml": MANIFEST}
    install("lamps", {"lamps": "lamps"}, files)
    with pytest.raises(RunFailed, match=said):
        parts("method", "BadSearch").replace(tasks=()).run()
