from collections.abc import Callable, Iterator

import pytest

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from tests.plugins.behavior.errands import Errands, open_errands

HOME = Point2D(1.0, 3.0)
FAR = Point2D(5.0, 1.5)


@pytest.fixture
def errands() -> Iterator[Callable[..., Errands]]:
    opened = open_errands("idle", "visit")
    build = next(opened)
    yield lambda **idle: build(parameters={"idle": {"return_after_s": 5.0, **idle}})
    opened.close()


@pytest.mark.slow
def test_a_robot_without_a_home_stays_where_it_is_until_it_is_told_one(errands):
    run = errands()
    run.finish(Task(id="v", kind="visit", place=Point2D(2.5, 1.5)))
    run.run(1.0)
    here = run.pose()
    run.run(10.0)
    assert run.pose() == here
    assert run.call("idle", "idle_s") == pytest.approx(11.0, abs=1.1)
    run.call("idle", "wait_at", HOME.x_m, HOME.y_m)
    run.run(25.0)
    assert run.pose().distance_m(HOME) < 0.4


@pytest.mark.slow
def test_a_robot_with_nothing_to_do_goes_home_after_a_while(errands):
    run = errands(home=[HOME.x_m, HOME.y_m])
    run.finish(Task(id="v", kind="visit", place=FAR))
    run.run(3.0)
    assert run.pose().distance_m(FAR) < 0.2
    run.run(25.0)
    assert run.pose().distance_m(HOME) < 0.4
    assert run.robot().board.behavior == "idle"
    path_m = run.path_m()
    run.run(10.0)
    assert run.path_m() == pytest.approx(path_m, abs=0.01)


def test_a_task_on_the_way_home_is_done_first(errands):
    run = errands(home=[HOME.x_m, HOME.y_m])
    run.finish(Task(id="v", kind="visit", place=FAR))
    run.run(7.0)
    assert run.robot().board.behavior == "return"
    run.finish(Task(id="again", kind="visit", place=FAR))
    assert run.pose().distance_m(FAR) < 0.2


@pytest.mark.slow
def test_a_home_that_cannot_be_reached_keeps_nobody_busy(errands):
    run = errands(home=[-5.0, 1.0])
    run.run(20.0)
    assert run.path_m() == 0.0
    assert run.finish(Task(id="v", kind="visit", place=FAR)).state == "done"


@pytest.mark.parametrize("home", [[1.0], [1.0, 2.0, 3.0], [float("nan"), 1.0]])
def test_a_home_that_is_no_place_is_refused(home):
    run = Errands("idle", parameters={"idle": {"home": home}})
    assert "home" in run.why_not_running()["idle"]
    run.close()
