"""An rclpy node in a process of its own, with built interfaces: prints a transform, then the answers of a service."""

import json
import sys
import time

import rclpy
from robrain_msgs.srv import SubmitTask
from tf2_msgs.msg import TFMessage

PATIENCE_S = 60.0


def main(*tasks: str) -> None:
    rclpy.init()
    node = rclpy.create_node("interface_client")
    transforms: list[TFMessage] = []
    node.create_subscription(TFMessage, "/tf", transforms.append, 10)
    ends_s = time.monotonic() + PATIENCE_S
    while not transforms and time.monotonic() < ends_s:
        rclpy.spin_once(node, timeout_sec=0.1)
    transform = transforms[0].transforms[0]
    place = transform.transform.translation
    frames = [transform.header.frame_id, transform.child_frame_id]
    sys.stdout.write(json.dumps({"frames": frames, "place": [place.x, place.y]}) + "\n")
    client = node.create_client(SubmitTask, "/robrain/submit_task")
    if not client.wait_for_service(PATIENCE_S):
        sys.exit("there is no /robrain/submit_task")
    for task in tasks:
        asked = client.call_async(SubmitTask.Request(task=task))
        rclpy.spin_until_future_complete(node, asked, timeout_sec=PATIENCE_S)
        answer = asked.result()
        sys.stdout.write(json.dumps({"accepted": answer.accepted, "answer": answer.answer}) + "\n")
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])
