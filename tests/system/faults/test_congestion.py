"""A subscriber that hangs slows no robot, and halts reach robots on a flooded network; who is not reached is named."""

import os
import signal

import numpy as np
import pytest

from robrain import Team
from tests.bench.congestion import TEAM, fleet, helper, stuck_reader

pytestmark = pytest.mark.system

WATCHED_S = 2.5
SLOWED = 2.0
SILENT_S = 1.5
"""Of a robot that is heard: a hub that waits for a reader which hangs waits for 5 s."""
HALTED_S = 0.5
"""50 ms as `make bench` measures, and what a busy machine adds."""


def test_reader_that_hangs_slows_no_robot_and_who_is_not_reached_by_a_halt_is_named() -> None:
    with fleet(2) as (team, endpoint, pids), helper("read", endpoint), helper("flood", endpoint):
        before = team.periods_s("r1", WATCHED_S)
        with stuck_reader(endpoint):
            during = team.periods_s("r1", WATCHED_S)
            for before_s, during_s in zip(before, during, strict=True):
                assert np.percentile(during_s, 90) < SLOWED * np.percentile(before_s, 90)
            assert max(during[1]) < SILENT_S
            assert max(team.halt_once()) < HALTED_S
        os.kill(pids["r2"], signal.SIGSTOP)
        try:
            with Team.connect(endpoint, team=TEAM, by="operator:ann") as client:
                report = client.halt()
                assert report.confirmed == ("r1",)
                assert list(report.unconfirmed) == ["r2"]
        finally:
            os.kill(pids["r2"], signal.SIGCONT)
