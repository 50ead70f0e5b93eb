"""Foxglove's messages as protobuf, made from ours: pure functions, arena frame, metres and radians.

Schemas are those of the package `foxglove-schemas-protobuf`; Foxglove, Lichtblick and Rerun draw them by name.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import OCCUPIED as OCCUPIED_CELL
from robrain.recording.drawing.palette import FREE, OCCUPIED, UNKNOWN, Rgb

ARENA = "arena"
"""The fixed frame."""
LAST_STAMP_NS = 2**63 - 1
WALL_HEIGHT_M = 0.5
UNKNOWN_ALPHA = 0
LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR, "critical": Log.FATAL}


def timestamp(stamp_ns: int) -> Timestamp:
    """Nanoseconds of the run's clock; a value out of protobuf's range becomes the nearest one in it."""
    stamp = Timestamp()
    stamp.FromNanoseconds(min(max(stamp_ns, 0), LAST_STAMP_NS))
    return stamp


def color(rgb: Rgb, alpha: float = 1.0) -> Color:
    """A colour of the palette."""
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=alpha)


def yaw_quaternion(yaw_rad: float) -> Quaternion:
    """A turn about z."""
    return Quaternion(z=math.sin(yaw_rad / 2), w=math.cos(yaw_rad / 2))


def pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> Pose:
    """A pose on or above the floor."""
    return Pose(position=Vector3(x=x_m, y=y_m, z=z_m), orientation=yaw_quaternion(yaw_rad))


def transforms(poses: Iterable[tuple[str, Pose2D, int]]) -> FrameTransforms:
    """Robots' frames: name, pose and stamp of each."""
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=timestamp(stamp_ns),
                parent_frame_id=ARENA,
                child_frame_id=robot,
                translation=Vector3(x=at.x_m, y=at.y_m),
                rotation=yaw_quaternion(at.yaw_rad),
            )
            for robot, at, stamp_ns in poses
        ]
    )


def pose_in_frame(at: Pose2D, stamp_ns: int) -> PoseInFrame:
    """One pose."""
    return PoseInFrame(timestamp=timestamp(stamp_ns), frame_id=ARENA, pose=pose(at.x_m, at.y_m, yaw_rad=at.yaw_rad))


def poses_in_frame(points: Sequence[Point2D], stamp_ns: int, z_m: float = 0.02) -> PosesInFrame:
    """Points that are joined to a line."""
    return PosesInFrame(
        timestamp=timestamp(stamp_ns), frame_id=ARENA, poses=[pose(point.x_m, point.y_m, z_m) for point in points]
    )


def laser_scan(scan: Scan, stamp_ns: int) -> LaserScan:
    """A scan in its robot's frame; a beam without a return is beyond the range, as infinity."""
    ranges_m = np.array(scan.ranges_mm, np.float64) / 1000
    ranges_m[ranges_m == 0] = np.inf
    beams = len(ranges_m)
    return LaserScan(
        timestamp=timestamp(stamp_ns),
        frame_id=scan.robot,
        pose=pose(0.0, 0.0, 0.1),
        start_angle=scan.angle_min_rad,
        end_angle=scan.angle_min_rad + scan.angle_increment_rad * max(beams - 1, 0),
        ranges=ranges_m.tolist(),
    )


def scan_points(scan: Scan, stamp_ns: int) -> PointCloud:
    """The hits of a scan as points in the robot's frame, for viewers that do not draw scans."""
    ranges_m = np.array(scan.ranges_mm, np.float32) / 1000
    angles_rad = scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges_m), dtype=np.float32)
    hits = ranges_m > 0
    points = np.full((int(hits.sum()), 3), 0.1, np.float32)
    points[:, 0] = ranges_m[hits] * np.cos(angles_rad[hits])
    points[:, 1] = ranges_m[hits] * np.sin(angles_rad[hits])
    return point_cloud(points, scan.robot, stamp_ns)


def wall_points(grid: OccupancyGrid, stamp_ns: int) -> PointCloud:
    """The middles of the occupied cells, for viewers that draw neither grids nor scenes."""
    rows, columns = np.nonzero(grid.classes() == OCCUPIED_CELL)
    geometry = grid.geometry
    points = np.zeros((len(rows), 3), np.float32)
    points[:, 0] = geometry.origin_x_m + (columns + 0.5) * geometry.resolution_m
    points[:, 1] = geometry.origin_y_m + (rows + 0.5) * geometry.resolution_m
    return point_cloud(points, ARENA, stamp_ns)


def point_cloud(points: NDArray[np.float32], frame: str, stamp_ns: int) -> PointCloud:
    """Points (N, 3), metres, in a frame."""
    fields = [
        PackedElementField(name=name, offset=4 * place, type=PackedElementField.FLOAT32)
        for place, name in enumerate("xyz")
    ]
    return PointCloud(
        timestamp=timestamp(stamp_ns),
        frame_id=frame,
        pose=pose(0.0, 0.0),
        point_stride=12,
        fields=fields,
        data=points.tobytes(),
    )


def map_grid(grid: OccupancyGrid, stamp_ns: int) -> Grid:
    """The known map as colours; unknown cells are transparent."""
    geometry = grid.geometry
    # Classes are −1, 0 and 100; as unsigned bytes 255, 0 and 100.
    colors = np.zeros((256, 4), np.uint8)
    colors[255] = (*UNKNOWN, UNKNOWN_ALPHA)
    colors[0], colors[100] = (*FREE, 255), (*OCCUPIED, 255)
    fields = [
        PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
        for offset, name in enumerate(("red", "green", "blue", "alpha"))
    ]
    return Grid(
        timestamp=timestamp(stamp_ns),
        frame_id=ARENA,
        pose=pose(geometry.origin_x_m, geometry.origin_y_m, -0.01),
        column_count=geometry.width,
        cell_size=Vector2(x=geometry.resolution_m, y=geometry.resolution_m),
        row_stride=4 * geometry.width,
        cell_stride=4,
        fields=fields,
        data=colors[grid.classes().view(np.uint8)].tobytes(),
    )


def wall_cubes(boxes: NDArray[np.float32], rgb: Rgb) -> list[CubePrimitive]:
    """Raised walls; boxes (N, 4) of middle x, y and sizes, metres."""
    wall = color(rgb)
    return [
        CubePrimitive(
            pose=pose(x_m, y_m, WALL_HEIGHT_M / 2), size=Vector3(x=width_m, y=depth_m, z=WALL_HEIGHT_M), color=wall
        )
        for x_m, y_m, width_m, depth_m in boxes.tolist()
    ]


def log(stamp_ns: int, level: str, source: str, text: str) -> Log:
    """One line of a log."""
    return Log(timestamp=timestamp(stamp_ns), level=LEVELS.get(level.lower(), Log.INFO), message=text, name=source)


def point(at: Point2D, z_m: float = 0.0) -> Point3:
    """A point on or above the floor."""
    return Point3(x=at.x_m, y=at.y_m, z=z_m)
