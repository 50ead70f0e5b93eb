"""Classes of messages, those of ROS 2 Jazzy in `rosbags`, by their names in ROS 2."""

from rosbags.typesys.stores.ros2_jazzy import action_msgs__msg__GoalInfo as GoalInfo
from rosbags.typesys.stores.ros2_jazzy import action_msgs__msg__GoalStatusArray as GoalStatusArray
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Duration as Duration
from rosbags.typesys.stores.ros2_jazzy import builtin_interfaces__msg__Time as Time
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Pose as Pose
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseStamped as PoseStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__PoseWithCovarianceStamped as PoseWithCovarianceStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TransformStamped as TransformStamped
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__Twist as Twist
from rosbags.typesys.stores.ros2_jazzy import geometry_msgs__msg__TwistStamped as TwistStamped
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__MapMetaData as MapMetaData
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__OccupancyGrid as OccupancyGrid
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Odometry as Odometry
from rosbags.typesys.stores.ros2_jazzy import nav_msgs__msg__Path as Path
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__BatteryState as BatteryState
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__Imu as Imu
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__LaserScan as LaserScan
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointCloud2 as PointCloud2
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Bool as Bool
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__Header as Header
from rosbags.typesys.stores.ros2_jazzy import std_msgs__msg__String as String
from rosbags.typesys.stores.ros2_jazzy import tf2_msgs__msg__TFMessage as TFMessage
from rosbags.typesys.stores.ros2_jazzy import unique_identifier_msgs__msg__UUID as UUID
from rosbags.typesys.stores.ros2_jazzy import visualization_msgs__msg__Marker as Marker
from rosbags.typesys.stores.ros2_jazzy import visualization_msgs__msg__MarkerArray as MarkerArray

__all__ = [
    "UUID",
    "BatteryState",
    "Bool",
    "Duration",
    "GoalInfo",
    "GoalStatusArray",
    "Header",
    "Imu",
    "LaserScan",
    "MapMetaData",
    "Marker",
    "MarkerArray",
    "OccupancyGrid",
    "Odometry",
    "Path",
    "PointCloud2",
    "Pose",
    "PoseStamped",
    "PoseWithCovarianceStamped",
    "String",
    "TFMessage",
    "Time",
    "TransformStamped",
    "Twist",
    "TwistStamped",
]
