"""An inertial measurement unit and the wheels say different things about how the robot turns."""

from robrain.agent.board import Board
from robrain.plugins.device.imu.errors import ImuContradicted


def check_agreement(board: Board) -> None:
    """Raise ImuContradicted if the odometry has found that the unit and the wheels contradict each other."""
    ratio = board.gyro_contradiction
    if ratio is None:
        return
    what = f"it turns {ratio:.2g} times as far as the wheels turn the robot"
    if ratio < 0:
        raise ImuContradicted(f"{what}: the unit is upside down, or counts to the right ([parameters.imu] upside_down)")
    raise ImuContradicted(f"{what}: check the unit of its turn rate")
