"""A ROS 2 program in a process of its own, written with `zenoh-ros2-sdk`, which knows nothing of robrain.

It publishes, subscribes, serves and calls, and prints each message as a JSON object on a line. `call` on its
input has it call robrain's service; it ends with its input.
"""

import json
import sys
import threading
from pathlib import Path
from typing import Any

from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.message_registry import get_registry
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

LATCHED = QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)
SWITCH = "std_srvs/srv/SetBool"


def tell(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def main(port: int, definitions: Path) -> None:
    get_registry().messages_dir = definitions
    where: dict[str, Any] = {"router_ip": "127.0.0.1", "router_port": port}

    def heard_scan(scan: Any) -> None:
        tell(scan=scan.ranges.tolist(), frame=scan.header.frame_id)

    def heard_map(grid: Any) -> None:
        tell(map=grid.data.tolist(), size=[grid.info.width, grid.info.height])

    def answer(request: Any) -> Any:
        return server.response_msg_class(success=request.data, message="from the sdk")

    publisher = ROS2Publisher("/sdk/chatter", "std_msgs/msg/String", node_name="sdk", namespace="/lab", **where)
    scans = ROS2Subscriber("/robrain/scan", "sensor_msgs/msg/LaserScan", heard_scan, **where)
    maps = ROS2Subscriber("/map", "nav_msgs/msg/OccupancyGrid", heard_map, qos=LATCHED, **where)
    server = ROS2ServiceServer("/sdk/switch", SWITCH, answer, **where)
    client = ROS2ServiceClient("/robrain/switch", SWITCH, **where)
    ended = threading.Event()

    def talk() -> None:
        while not ended.wait(0.05):
            publisher.publish(data="hello")

    talking = threading.Thread(target=talk)
    talking.start()
    tell(ready=True)
    for line in sys.stdin:
        if line.strip() == "call":
            response: Any = client.call(data=True)
            tell(success=bool(response.success), message=response.message)
    ended.set()
    talking.join()
    for each in (client, server, maps, scans, publisher):
        each.close()
    publisher.session_mgr.close()


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
