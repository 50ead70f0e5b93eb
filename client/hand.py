"""`Hand`: drives one robot by hand, from a script."""

from collections.abc import Mapping
from typing import Any, Self

from robrain.client.team import Team
from robrain.protocol.answers.hand_control import DRIVER, HandControl

CALL_TIMEOUT_S = 0.5


class Hand:
    """Drives one robot by hand; use it in a `with` block, at whose end the robot is released.

    The robot stands within 0.3 s after the script ends, hangs or loses its link. It stops before obstacles by itself.
    Paths that it is given meanwhile wait; its own actions are not affected by the lease.

    with robrain.Hand(team, "r1") as hand:
        hand.drive(2.0, forward_m_s=0.3)

    Args:
        team: robot to drive; its `by` names the holder.
        robot: name of the robot.

    """

    def __init__(self, team: Team, robot: str) -> None:
        self._team = team
        self._robot = robot
        self._control = HandControl(self._call, team.by)

    def move(self, *, forward_m_s: float = 0.0, left_m_s: float = 0.0, yaw_rad_s: float = 0.0) -> None:
        """Ask for a velocity, body frame, which holds for 0.1 s by default; zero gives the robot back.

        Raises:
            CallError: another client drives the robot by hand (`busy`), or it is halted.
            NobodyThere: the robot is absent.

        """
        self._control.move(forward_m_s, left_m_s, yaw_rad_s)

    def drive(self, seconds: float, *, forward_m_s: float = 0.0, left_m_s: float = 0.0, yaw_rad_s: float = 0.0) -> None:
        """Drive at a velocity, body frame, for some time, and give the robot back; raises as `move`."""
        transport = self._team.transport
        until_s = transport.elapsed_s() + seconds
        try:
            while transport.elapsed_s() < until_s:
                self._control.move(forward_m_s, left_m_s, yaw_rad_s)
                transport.pass_time(self._control.renew_s)
        finally:
            self._control.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._control.release()

    def _call(self, function: str, arguments: Mapping[str, object]) -> Any:
        return self._team.call(self._robot, DRIVER, function, named=arguments, timeout_s=CALL_TIMEOUT_S)
