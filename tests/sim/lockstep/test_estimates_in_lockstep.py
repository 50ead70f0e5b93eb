"""The expected end of a task in a simulated team, while its robot is stopped by an obstacle."""

import pytest

from robrain.protocol.model.tasks.task import TaskState
from robrain.sim.scenarios.scenario import Scenario

CORRIDOR = """
[scenario]
name = "corridor"
[floor]
size_m = [16.0, 5.0]
blocks = [
  { x_m = 6.0, y_m = 0.0, width_m = 6.0, height_m = 0.8 },
  { x_m = 6.0, y_m = 2.2, width_m = 2.3, height_m = 2.8 },
  { x_m = 9.7, y_m = 2.2, width_m = 2.3, height_m = 2.8 },
]
[team]
robots = 1
near_m = [2.0, 1.5]
[[movers]]  # from an alcove into the corridor, for half a minute
via_m = [[9.0, 4.2], [9.0, 1.5]]
radius_m = 0.65
at_s = 78.0
pause_s = 30.0
stop_m = 0.0
"""


@pytest.mark.slow
def test_end_grows_within_two_seconds_while_a_robot_is_stopped_by_an_obstacle() -> None:
    with Scenario.from_toml(CORRIDOR).team(seed=1) as team:
        team.run_for(50.0)
        team.submit("visit", place=(2.0, 1.5), id="back")
        team.run_for(26.0)
        team.submit("visit", place=(14.0, 1.5), id="through")
        ends_s, stopped_s = [], None
        while (record := team.get("through")).state is not TaskState.DONE:
            team.run_for(0.5)
            if record.estimate is not None:
                ends_s.append((team.now_s - 0.5, team.now_s - 0.5 + record.estimate.ends_in_s))
            if stopped_s is None and team.now_s > 80.0 and abs(team.state("r1").velocity.forward_m_s) < 0.02:
                stopped_s = team.now_s
            assert team.now_s < 150.0
        end_s = record.changed_ns / 1e9
    assert stopped_s is not None
    driving = [end for now, end in ends_s if stopped_s - 4.0 < now < stopped_s]
    assert max(driving) - min(driving) < 1.0
    (early, late) = (next(end for now, end in ends_s if now >= stopped_s + after_s) for after_s in (2.0, 12.0))
    assert early > max(driving) + 0.5
    assert late > max(driving) + 9.0
    assert ends_s[-1][1] == pytest.approx(end_s, abs=1.0)
    assert end_s - stopped_s > 35.0
