"""Values of the wire that compute: bids, work."""

import pytest

from robrain.protocol.model.ballot import Bid
from robrain.protocol.model.energy_model import Work


@pytest.mark.parametrize(
    ("bid", "other", "is_better"),
    [
        (("r1", 5.0), None, True),
        (("r2", 5.0), ("r1", 4.0), True),
        (("r1", 4.0), ("r2", 5.0), False),
        (("r1", 5.0), ("r2", 5.0), True),
        (("r2", 5.0), ("r1", 5.0), False),
        (("r1", 5.0), ("r1", 5.0), False),
    ],
)
def test_the_greater_score_wins_and_the_lesser_name_decides_a_tie(bid, other, is_better) -> None:
    def made(robot: str, score: float) -> Bid:
        return Bid(task="t1", robot=robot, score=score)

    assert made(*bid).beats(None if other is None else made(*other)) is is_better


def test_work_in_sequence_takes_the_time_of_both_paths() -> None:
    both = Work(6.0, 1.0, 2.0, 3, 0.5) + Work(4.0, 0.5, 1.0, 4, 1.0)
    assert (both.path_m, both.turn_rad, both.wait_s, both.radio_packets) == (10.0, 1.5, 3.0, 7)
    assert both.speed_m_s == pytest.approx(10.0 / (6.0 / 0.5 + 4.0 / 1.0))


def test_work_without_a_path_leaves_the_speed_of_the_other() -> None:
    assert (Work(wait_s=5.0) + Work(4.0, speed_m_s=1.0)).speed_m_s == 1.0
    assert (Work(3.0) + Work(4.0)).speed_m_s is None
