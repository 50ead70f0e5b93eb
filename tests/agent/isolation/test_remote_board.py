"""The board as a plugin in a process of its own sees it: facts cross the border as what they are."""

from typing import Any

import pytest

from robrain.agent.isolation.child import RemoteBoard
from robrain.agent.isolation.contract import decoder
from robrain.agent.isolation.messages import BOARD_TYPES, ReadBoard, WriteBoard
from robrain.protocol.model.geometry import Pose2D


class Parent:
    """Keeps what is written, as bytes, and gives it back as the robot's process does."""

    def __init__(self) -> None:
        self.board: dict[str, bytes] = {}

    def send(self, said: WriteBoard) -> None:
        self.board[said.name] = said.value
        decoder(BOARD_TYPES[said.name]).decode(said.value)  # as the robot's process reads it

    def ask(self, asked: ReadBoard) -> bytes:
        return self.board[asked.name]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("odometry", ((20_000_000, Pose2D(1.0, 2.0, 0.5)), (40_000_000, Pose2D(1.1, 2.0, 0.5)))),
        ("published_odometry", (Pose2D(1.0, 2.0, 0.5), 7)),
        ("published_odometry", None),
        ("wants_odometry", True),
        ("gyro_contradiction", -1.0),
        ("wheel_ticks", (1, 2, 3)),
    ],
)
def test_what_devices_leave_on_the_board_is_the_same_on_both_sides(name: str, value: Any) -> None:
    parent: Any = Parent()
    board = RemoteBoard(parent)
    setattr(board, name, value)
    assert getattr(board, name) == value
