"""Vehicles that speak VDA 5050, written from the standard alone: paho-mqtt and json, nothing of the product.

python -m tests.deploy.vda5050.vehicle_simulator PORT VERSION VEHICLES LOG
"""

import datetime
import json
import math
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tests.deploy.vda5050.published_schemas import mistakes

TICK_S, SPEED_M_S, STATE_S = 0.02, 8.0, 1.0
NAMES_2 = {"position": "agvPosition", "localized": "positionInitialized", "interface": "uagv/v2"}
NAMES_3 = {"position": "mobileRobotPosition", "localized": "localized", "interface": "vda5050/v3"}


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


class SimulatedVehicle:
    """A vehicle that drives straight from node to node, at constant speed."""

    def __init__(self, port: int, version: str, serial: str, x_m: float, y_m: float, log: Any) -> None:
        self.version, self.serial, self.log = version, serial, log
        self.names = NAMES_2 if version == "2.1.0" else NAMES_3
        self.base = f"{self.names['interface']}/acme/{serial}"
        self.x_m, self.y_m, self.theta = x_m, y_m, 0.0
        self.order: dict[str, Any] = {"orderId": "", "orderUpdateId": 0}
        self.last_node, self.last_sequence = "", 0
        self.nodes: list[dict[str, Any]] = []
        self.edges: list[dict[str, Any]] = []
        self.instant: list[dict[str, str]] = []
        self.errors: list[dict[str, Any]] = []
        self.zone_sets: dict[str, str] = {}
        self.paused = self.driving = False
        self.mode = "AUTOMATIC"
        self.header_ids: dict[str, int] = {}
        self.published_s = 0.0
        self.inbox: deque[tuple[str, bytes]] = deque()
        self.online = 0
        self.seen_online = 0
        self.client = Client(CallbackAPIVersion.VERSION2, f"vehicle-{serial}")
        self.client.on_connect, self.client.on_message = self.on_connect, self.on_message
        broken = "CONNECTIONBROKEN" if version == "2.1.0" else "CONNECTION_BROKEN"
        self.client.will_set(f"{self.base}/connection", self.message("connection", connectionState=broken), 1, True)
        self.client.reconnect_delay_set(1, 1)
        self.client.connect_async("127.0.0.1", port, keepalive=5)
        self.client.loop_start()

    def on_connect(self, client: Client, _data: Any, _flags: Any, _reason: Any, _properties: Any) -> None:
        client.subscribe([(f"{self.base}/{name}", 0) for name in ("order", "instantActions", "zoneSet")])
        self.online += 1

    def on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        self.inbox.append((message.topic, bytes(message.payload)))

    def message(self, name: str, **fields: Any) -> bytes:
        self.header_ids[name] = self.header_ids.get(name, -1) + 1
        message = {
            "headerId": self.header_ids[name],
            "timestamp": datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            "version": self.version, "manufacturer": "acme", "serialNumber": self.serial, **fields,
        }  # fmt: skip
        wrong = mistakes(self.version, f"own/{name}", message)
        assert not wrong, wrong
        return json.dumps(message).encode()

    def write(self, event: str, **fields: Any) -> None:
        self.log.write(json.dumps({"event": event, "vehicle": self.serial, **fields}) + "\n")
        self.log.flush()

    def tick(self, now_s: float) -> None:
        if self.online != self.seen_online:
            self.seen_online = self.online
            self.client.publish(
                f"{self.base}/connection", self.message("connection", connectionState="ONLINE"), 1, True
            )
            self.published_s = 0.0
        while self.inbox:
            topic, payload = self.inbox.popleft()
            message = json.loads(payload)
            wrong = mistakes(self.version, topic, message)
            self.write("message", topic=topic.rpartition("/")[2], wrong=wrong)
            {"order": self.take_order, "instantActions": self.take_actions, "zoneSet": self.take_zones}[
                topic.rpartition("/")[2]
            ](message)
            self.published_s = 0.0
        self.drive()
        if now_s - self.published_s >= STATE_S:
            self.published_s = now_s
            self.client.publish(f"{self.base}/state", self.state())

    def take_order(self, order: dict[str, Any]) -> None:
        old = self.order
        if order["orderId"] == old["orderId"] and order["orderUpdateId"] == old["orderUpdateId"]:
            return
        start = order["nodes"][0]["nodePosition"]
        if self.nodes:
            self.reject("orderUpdateError" if self.version == "2.1.0" else "OTHER_ORDER_ACTIVE", order)
        elif math.hypot(start["x"] - self.x_m, start["y"] - self.y_m) > 0.5:
            self.reject("orderError" if self.version == "2.1.0" else "START_NODE_OUT_OF_RANGE", order)
        elif any(node["nodePosition"]["mapId"] != "hall" for node in order["nodes"]):
            self.reject("orderError" if self.version == "2.1.0" else "UNKNOWN_MAP_ID", order)
        else:
            self.order, self.errors = order, []
            self.instant = [action for action in self.instant if action["actionStatus"] == "RUNNING"]
            self.nodes, self.edges = list(order["nodes"]), list(order["edges"])
            self.write("accepted", order=order["orderId"])
            self.reach()

    def reject(self, kind: str, order: dict[str, Any]) -> None:
        reference = {"referenceKey": "orderId", "referenceValue": order["orderId"]}
        self.errors.append({"errorType": kind, "errorLevel": "WARNING", "errorReferences": [reference]})
        self.write("rejected", order=order["orderId"], why=kind)

    def take_actions(self, message: dict[str, Any]) -> None:
        for action in message["actions"]:
            status = "FINISHED"
            if action["actionType"] == "cancelOrder":
                if self.nodes:
                    self.write("cancelled", order=self.order["orderId"])
                    self.nodes, self.edges = [], []
                else:
                    status = "FAILED"
            elif action["actionType"] in ("startPause", "stopPause"):
                self.paused = action["actionType"] == "startPause"
            elif action["actionType"] == "enableZoneSet":
                (name,) = (one["value"] for one in action["actionParameters"])
                self.zone_sets = {one: "ENABLED" if one == name else "DISABLED" for one in self.zone_sets}
            self.instant.append({"actionId": action["actionId"], "actionType": action["actionType"],
                                 "actionStatus": status})  # fmt: skip
            self.instant = self.instant[-20:]

    def take_zones(self, message: dict[str, Any]) -> None:
        self.write("zones", zones=message["zoneSet"])
        self.zone_sets[message["zoneSet"]["zoneSetId"]] = "DISABLED"

    def drive(self) -> None:
        was, before = self.driving, len(self.nodes)
        left_m = 0.0 if self.paused or self.mode != "AUTOMATIC" else SPEED_M_S * TICK_S
        self.driving = bool(self.nodes) and left_m > 0.0
        while self.nodes and left_m > 0.0:
            at = self.nodes[0]["nodePosition"]
            dx_m, dy_m = at["x"] - self.x_m, at["y"] - self.y_m
            away_m = math.hypot(dx_m, dy_m)
            if away_m > left_m:
                self.x_m += dx_m * left_m / away_m
                self.y_m += dy_m * left_m / away_m
                self.theta = math.atan2(dy_m, dx_m)
                break
            self.x_m, self.y_m = at["x"], at["y"]
            left_m -= away_m
            self.reach()
        self.driving = self.driving and bool(self.nodes)
        if self.driving != was or len(self.nodes) != before:
            self.published_s = 0.0

    def reach(self) -> None:
        node = self.nodes.pop(0)
        self.last_node, self.last_sequence = node["nodeId"], node["sequenceId"]
        self.edges = [edge for edge in self.edges if edge["sequenceId"] > node["sequenceId"]]
        if not self.nodes:
            self.write("completed", order=self.order["orderId"])

    def state(self) -> bytes:
        position = {
            "x": self.x_m, "y": self.y_m, "theta": self.theta, "mapId": "hall", self.names["localized"]: True,
        }  # fmt: skip
        fields: dict[str, Any] = {
            "orderId": self.order["orderId"], "orderUpdateId": self.order["orderUpdateId"],
            "lastNodeId": self.last_node, "lastNodeSequenceId": self.last_sequence, "driving": self.driving,
            "paused": self.paused, "operatingMode": self.mode, "errors": self.errors,
            "nodeStates": [
                {key: node[key] for key in ("nodeId", "sequenceId", "released")} for node in self.nodes
            ],
            "edgeStates": [{key: edge[key] for key in ("edgeId", "sequenceId", "released")} for edge in self.edges],
            self.names["position"]: position,
        }  # fmt: skip
        if self.version == "2.1.0":
            fields |= {"actionStates": self.instant, "batteryState": {"batteryCharge": 80.0, "charging": False},
                       "safetyState": {"eStop": "NONE", "fieldViolation": False}}  # fmt: skip
        else:
            zone_sets = [
                {"zoneSetId": name, "mapId": "hall", "zoneSetStatus": status} for name, status in self.zone_sets.items()
            ]
            fields |= {"actionStates": [], "instantActionStates": self.instant, "zoneSets": zone_sets,
                       "powerSupply": {"stateOfCharge": 80.0, "charging": False},
                       "safetyState": {"activeEmergencyStop": "NONE", "fieldViolation": False}}  # fmt: skip
        return self.message("state", **fields)


def main() -> None:
    port, version, count, log = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])
    with log.open("a") as stream:
        vehicles = [
            SimulatedVehicle(port, version, f"v{number}", 1.0 + 2.0 * number, 1.0, stream) for number in range(count)
        ]
        say("vehicles are there")
        while True:
            began_s = time.monotonic()
            for vehicle in vehicles:
                vehicle.tick(began_s)
            line = drop_request(log)
            if line:
                for vehicle in vehicles:
                    broken = vehicle.client.socket()
                    if broken is not None:
                        broken.shutdown(2)
            time.sleep(max(0.0, TICK_S - (time.monotonic() - began_s)))


def drop_request(log: Path) -> bool:
    """Whether the test wants the vehicles to lose their connections now: it makes a file beside the log."""
    wish = log.with_suffix(".drop")
    if wish.exists():
        wish.unlink()
        return True
    return False


if __name__ == "__main__":
    main()
