"""A plugin of your own: measures the distance that the robot has driven."""

from robrain import Unit, external


class Trip(Unit):
    """Counts the metres that the robot has driven since the plugin was loaded."""

    period_s = 0.1

    def init(self) -> None:
        self._path_m, self._last = 0.0, None

    def step(self) -> None:
        pose = self.env.board.pose
        if pose is not None and self._last is not None:
            self._path_m += pose.distance_m(self._last)
        self._last = pose

    @external
    def distance_m(self) -> float:
        """Metres since the plugin was loaded."""
        return round(self._path_m, 2)
