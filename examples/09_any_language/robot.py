"""A robot of a live team, with the standard library and Zenoh only: a point that drives straight to its tasks.

robrain wire --format jsonschema | python robot.py tcp/127.0.0.1:7447 p1
"""

import contextlib
import json
import math
import sys
import threading
import time

import zenoh
from wire import Refused, Wire

PERIOD_S, SPEED_M_S, RADIUS_M = 0.1, 0.5, 0.15
START = (3.0, 3.0)
ENDED = ("done", "failed", "cancelled")


class Robot:
    """Follows docs/reference/robot-contract.md. Callbacks run in Zenoh's threads, so all share a lock."""

    def __init__(self, wire, name):
        self.wire, self.name = wire, name
        self.lock = threading.RLock()
        self.x_m, self.y_m, self.yaw_rad = *START, 0.0
        self.moving = False
        self.task = self.status = None
        self.epoch, self.lease_s, self.received_s, self.stays_until_s = 0, 0.0, 0.0, None
        self.halted_by, self.halt_stamp_ns = [], 0

    def join(self):
        """Serve all queries, subscribe, query the current halt, and then declare the token."""
        for row, answer in (
            ("robot_plugins", self.plugins),
            ("robot_offer", self.offer),
            ("robot_withdraw", self.withdraw),
            ("host_halt", lambda request: self.halt({"halted": True, **request})),
            ("host_resume", lambda request: self.halt({"halted": False, **request})),
        ):
            self.wire.serve(row, answer, robot=self.name)
        self.wire.listen("halt", self.team_halt)
        self.wire.listen("coordinator_state", self.coordinator_state)
        with contextlib.suppress(Refused):  # there is no coordinator
            self.halt_of_coordinator(self.wire.ask("coordinator_halt") or {"halted": False})
        return self.wire.session.liveliness().declare_token(self.wire.key("robot_alive", robot=self.name))

    def plugins(self, _request):
        """One plugin, which announces one kind of task."""
        kind = {"kind": "visit", "doc": "drives to a place and stays there", "parameters": {"type": "object"}}
        return [{"name": "point_drive", "level": "behavior", "state": "active", "task_kind": kind}]

    def offer(self, request):
        """Accept a task if its epoch is not old."""
        task, epoch = request["task"], request["epoch"]
        with self.lock:
            if epoch < self.epoch:
                return {"accepted": False, "why": f"epoch {self.epoch} is newer", "epoch": self.epoch}
            if self.status and (self.status["id"], self.status["epoch"]) == (task["id"], epoch):
                return {"accepted": True}
            if self.halted_by or task["kind"] != "visit" or request.get("after"):
                return {"accepted": False, "why": "halted" if self.halted_by else "only single visits"}
            self.task, self.epoch, self.lease_s = task, epoch, request["lease_s"]
            self.received_s, self.stays_until_s = time.monotonic(), None
            self.status = {"id": task["id"], "epoch": epoch, "state": "running"}
            return {"accepted": True}

    def withdraw(self, request):
        """Release a task that the coordinator withdraws."""
        with self.lock:
            if request["epoch"] < self.epoch:
                return {"accepted": False, "why": f"epoch {self.epoch} is newer", "epoch": self.epoch}
            if self.status and self.status["id"] == request["id"]:
                self.end("cancelled", request.get("why", "withdrawn"))
            return {"accepted": True}

    def end(self, state, why=""):
        """End the running task, if there is one."""
        if self.task is not None:
            self.task, self.status = None, {**self.status, "state": state, "why": why}

    def team_halt(self, message):
        """Halt or resume with the team."""
        with self.lock:
            self.halt_stamp_ns = max(self.halt_stamp_ns, message["stamp_ns"])
            self.halt(message)

    def halt(self, request):
        """Stop and latch the halt, or end the halt of the sender; operators end all halts."""
        with self.lock:
            by = request.get("by", "")
            if request["halted"]:
                self.halted_by = sorted({*self.halted_by, by})
                self.end("cancelled", "the robot is halted")
            else:
                self.halted_by = [] if by.startswith("operator") else [name for name in self.halted_by if name != by]
                if self.halted_by:
                    raise ValueError(f"{self.name} stays halted by {', '.join(self.halted_by)}")
            return {"robot": self.name, "halted": bool(self.halted_by), "by": self.halted_by}

    def halt_of_coordinator(self, status):
        """Latch a halt that was missed."""
        if status["halted"] and status["stamp_ns"] > self.halt_stamp_ns:
            self.halt_stamp_ns = status["stamp_ns"]
            for by in status["by"]:
                self.halt({"halted": True, "by": by})

    def coordinator_state(self, message):
        """Renew the lease, counted from the state of this robot that the coordinator received last."""
        with self.lock:
            if message.get("halt"):
                self.halt_of_coordinator(message["halt"])
            for robot in message["robots"]:
                if robot["name"] == self.name and robot["up"]:
                    self.received_s = max(self.received_s, time.monotonic() - robot["age_s"])

    def step(self):
        """Drive for one period, and publish."""
        with self.lock:
            if self.task is not None and time.monotonic() - self.received_s > self.lease_s:
                self.end("cancelled", "the coordinator is silent, the lease ran out")
            moved_m = self.drive()
            if (moved_m > 0.0) != self.moving:
                self.moving = moved_m > 0.0
                here = {"x_m": self.x_m, "y_m": self.y_m}
                points = [here, self.task["place"]] if self.moving else []
                self.wire.put("robot_path", robot=self.name, points=points, speed_m_s=SPEED_M_S)
            self.wire.put(
                "robot_state",
                robot=self.name,
                pose={"x_m": self.x_m, "y_m": self.y_m, "yaw_rad": self.yaw_rad},
                velocity={"vx_m_s": moved_m / PERIOD_S},
                radius_m=RADIUS_M,
                behavior="point_drive" if self.task else "",
                task=self.status,
                halted=bool(self.halted_by),
                halted_by=self.halted_by,
                team_halt_ns=self.halt_stamp_ns if self.halted_by else 0,
            )

    def drive(self):
        """Move towards the task's place, stay there, and end the task; returns the metres moved."""
        if self.task is None:
            return 0.0
        place = self.task["place"]
        dx_m, dy_m = place["x_m"] - self.x_m, place["y_m"] - self.y_m
        distance_m = math.hypot(dx_m, dy_m)
        if distance_m == 0.0:
            now_s = time.monotonic()
            self.stays_until_s = self.stays_until_s or now_s + self.task.get("service_s", 0.0)
            if now_s >= self.stays_until_s:
                self.end("done")
            return 0.0
        moved_m = min(SPEED_M_S * PERIOD_S, distance_m)
        self.x_m += dx_m * moved_m / distance_m
        self.y_m += dy_m * moved_m / distance_m
        if moved_m == distance_m:
            self.x_m, self.y_m = place["x_m"], place["y_m"]
        self.yaw_rad = math.atan2(dy_m, dx_m)
        return moved_m


def main():
    """Run the robot until Ctrl-C."""
    document = json.load(sys.stdin)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:2]))
    with zenoh.open(config) as session:
        robot = Robot(Wire(document, session), sys.argv[2])
        token = robot.join()
        print(f"{robot.name} is a robot of the team", flush=True)
        try:
            while True:
                robot.step()
                time.sleep(PERIOD_S)
        except KeyboardInterrupt:
            token.undeclare()


if __name__ == "__main__":
    main()
