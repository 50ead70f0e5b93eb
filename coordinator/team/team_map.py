"""The team's map: the robots' patches, merged."""

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import OCCUPIED
from robrain.protocol.model.zone import Zone, opened

if TYPE_CHECKING:
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
    from robrain.algorithms.mapping.zone_grid import ZoneGrid
    from robrain.algorithms.navigation.separation import Separation
    from robrain.algorithms.slam.submap_atlas import SubmapAtlas

HELD_PATCHES = 16384
"""As many as wait in the coordinator's inbox."""


class TeamMap:
    """The team's knowledge of the floor. The first patch determines the grid on which the team maps."""

    def __init__(self) -> None:
        self._atlas: SubmapAtlas | None = None
        self._held: deque[tuple[MapPatch, int | None]] | None = None
        self._zones: tuple[Zone, ...] = ()
        self.shut_zones: tuple[Zone, ...] = ()
        """The zones that hold now and open again."""
        self._zone_changes = 0
        self._zoned: dict[bool, tuple[OccupancyGrid, ZoneGrid]] = {}
        """The map with keep-out zones; with shut zones, and without."""

    @property
    def seen(self) -> "OccupancyGrid | None":
        """The robots' submaps, composed; None before the first patch. Read-only."""
        return None if self._atlas is None else self._atlas.grid

    @property
    def grid(self) -> "OccupancyGrid | None":
        """The map on which robots drive: as `seen`, but keep-out zones that bind all robots are occupied."""
        return self._with_zones(with_shut=True)

    @property
    def opened(self) -> "OccupancyGrid | None":
        """As `grid`, once all zones have opened that open again."""
        return self._with_zones(with_shut=not self.shut_zones)

    def _with_zones(self, *, with_shut: bool) -> "OccupancyGrid | None":
        seen = self.seen
        if seen is None or not self._zone_changes:
            return seen
        version = seen.version + self._zone_changes
        zoned, zone_grid = self._zoned.get(with_shut, (None, None))
        if zoned is None or zoned.version != version:
            from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
            from robrain.algorithms.mapping.zone_grid import ZoneGrid

            if zone_grid is None:
                zones = self._zones if with_shut else opened(self._zones)
                zone_grid = ZoneGrid([zone for zone in zones if not zone.robots], seen.geometry)
            zoned = OccupancyGrid(seen.geometry)
            zoned.log_odds[:] = zone_grid.close(seen.log_odds, -int(OCCUPIED))
            zoned.version, zoned.known_count = version, int((zoned.log_odds != 0).sum())
            self._zoned[with_shut] = zoned, zone_grid
        return zoned

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The zones that hold now."""
        return self._zones

    def shut_at(self, place: Point2D) -> Zone | None:
        """The shut zone for all robots in which a place lies; None if there is none."""
        return next((zone for zone in self.shut_zones if not zone.robots and zone.holds(place)), None)

    def separation(self, robots: Sequence[RobotState]) -> "Separation | None":
        """Zones that all these robots obey, between them and places; None while no zone is shut, or no map is known.

        Robots in such zones do not count: they leave.
        """
        if self.seen is None or not self.shut_zones:
            return None
        from robrain.algorithms.navigation.separation import Separation

        zones = [zone for zone in self._zones if all(zone.binds(robot.robot) for robot in robots)]
        places = [Point2D(robot.pose.x_m, robot.pose.y_m) for robot in robots if robot.pose is not None]
        outside = [place for place in places if not any(zone.keeps_out and zone.holds(place) for zone in zones)]
        radius_m = min((robot.radius_m for robot in robots), default=0.0)
        return Separation(self.seen.classes(), self.seen.geometry, zones, outside, radius_m)

    def zone(self, name: str) -> Zone | None:
        """Such a zone by name; None if there is none."""
        return next((zone for zone in self._zones if zone.name == name), None)

    def set_zones(self, zones: Sequence[Zone]) -> None:
        """Obey these zones from now on."""
        self._zones, self.shut_zones = tuple(zones), tuple(zone for zone in zones if zone.is_shut)
        self._zoned = {}
        self._zone_changes += 1

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        return 0 if self.grid is None else self.grid.version

    @property
    def known_area_m2(self) -> float:
        """Area of the known floor, walls included."""
        return 0.0 if self.seen is None else self.seen.known_count * self.seen.geometry.resolution_m**2

    def hold(self) -> None:
        """Take nothing in until `release`: patches wait, the last 16384 of them."""
        self._held = deque(maxlen=HELD_PATCHES)

    def release(self) -> list[tuple[str, str]]:
        """Merge the held patches, and hold none from now on.

        Returns:
            Robot and reason for each patch that was rejected.

        """
        held, self._held = self._held, None
        merged = [(patch.robot, self.merge(patch, now_ns)) for patch, now_ns in held or ()]
        return [(robot, rejection) for robot, rejection in merged if rejection]

    def merge(self, patch: MapPatch, now_ns: int | None = None) -> str:
        """Merge a robot's patch; one that does not fit is rejected and changes nothing.

        Args:
            patch: from a robot of the team.
            now_ns: the current time, by which the patch counts; None leaves its times as they are.

        Returns:
            Why it was rejected; empty if it was merged or is held.

        """
        if self._held is not None:
            self._held.append((patch, now_ns))
            return ""
        # Imported here: they load the map's kernels, which a coordinator does once it is up (coordinator/live.py).
        from robrain.algorithms.mapping.patch_cells import MAX_CELLS, geometry_of
        from robrain.algorithms.slam.map_patch import in_own_time, merge_message
        from robrain.algorithms.slam.submap_atlas import SubmapAtlas

        try:
            if now_ns is not None:
                patch = in_own_time(patch, now_ns)
            atlas = self._atlas
            if atlas is None:
                geometry = geometry_of(patch)
                cells = geometry.width * geometry.height
                if cells > MAX_CELLS:
                    size = f"{geometry.width} x {geometry.height}"
                    raise ValueError(f"expected a grid of at most {MAX_CELLS} cells, got {size}")
                atlas = SubmapAtlas(geometry)
            merge_message(atlas, patch)
            self._atlas = atlas  # not before: a first patch that is broken must not determine the grid
        except ValueError as error:
            return f"the map of {patch.robot} cannot be merged: {error}"
        return ""
