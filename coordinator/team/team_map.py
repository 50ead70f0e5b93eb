"""The team's map: the robots' patches, merged."""

from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import OCCUPIED
from robrain.protocol.model.zone import Zone
from robrain.protocol.reasons import DoorShut

if TYPE_CHECKING:
    from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
    from robrain.algorithms.mapping.zone_grid import ZoneGrid
    from robrain.algorithms.slam.submap_atlas import SubmapAtlas

HELD_PATCHES = 16384
"""As many as wait in the coordinator's inbox."""


class TeamMap:
    """The team's knowledge of the floor. The first patch determines the grid on which the team maps."""

    def __init__(self) -> None:
        self._atlas: SubmapAtlas | None = None
        self._held: deque[tuple[MapPatch, int | None]] | None = None
        self._zones: tuple[Zone, ...] = ()
        self._zone_changes = 0
        self._zoned: OccupancyGrid | None = None
        self._zone_grid: ZoneGrid | None = None

    @property
    def seen(self) -> "OccupancyGrid | None":
        """The robots' submaps, composed; None before the first patch. Read-only."""
        return None if self._atlas is None else self._atlas.grid

    @property
    def grid(self) -> "OccupancyGrid | None":
        """The map on which robots drive: as `seen`, but keep-out zones that bind all robots are occupied."""
        seen = self.seen
        if seen is None or not self._zone_changes:
            return seen
        version = seen.version + self._zone_changes
        if self._zoned is None or self._zoned.version != version:
            from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
            from robrain.algorithms.mapping.zone_grid import ZoneGrid

            if self._zone_grid is None:
                self._zone_grid = ZoneGrid([zone for zone in self._zones if not zone.robots], seen.geometry)
            self._zoned = OccupancyGrid(seen.geometry)
            self._zoned.log_odds[:] = self._zone_grid.close(seen.log_odds, -int(OCCUPIED))
            self._zoned.version, self._zoned.known_count = version, int((self._zoned.log_odds != 0).sum())
        return self._zoned

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The zones that hold now."""
        return self._zones

    def shut_door_before(self, place: Point2D, robots: Sequence[RobotState], near_m: float) -> DoorShut | None:
        """The door that does not open and keeps all robots farther from a place than that; None if there is none."""
        if self.seen is None or not any(zone.is_shut for zone in self._zones):
            return None
        from robrain.algorithms.navigation.separation import separating_zones

        seen, places = self.seen, [Point2D(one.pose.x_m, one.pose.y_m) for one in robots if one.pose is not None]
        radius_m = min((robot.radius_m for robot in robots), default=0.0)
        names = separating_zones(seen.classes(), seen.geometry, self._zones, place, places, radius_m, near_m)
        return next((DoorShut(zone.name) for zone in self._zones if zone.is_shut and zone.name in names), None)

    def zone(self, name: str) -> Zone | None:
        """Such a zone by name; None if there is none."""
        return next((zone for zone in self._zones if zone.name == name), None)

    def set_zones(self, zones: Sequence[Zone]) -> None:
        """Obey these zones from now on."""
        self._zones = tuple(zones)
        self._zone_grid = None
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
