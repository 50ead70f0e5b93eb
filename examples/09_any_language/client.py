"""A client of a live team, based on the output of `robrain wire`: it uses the standard library and Zenoh only.

robrain wire --format jsonschema | python client.py tcp/127.0.0.1:7447
"""

import json
import math
import queue
import sys
import time

import zenoh
from wire import ME, Refused, Wire, resolved

PLACE = {"x_m": 4.2, "y_m": 3.0}
WANDER_S, AGAIN_S, PATIENCE_S = 10.0, 0.2, 120.0


def until(condition, what, step=lambda: None):
    """Wait for a true value."""
    ends_s = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > ends_s:
            sys.exit(f"without success: {what}")
        step()
        time.sleep(AGAIN_S)
    return found


def patiently(wire, *asked, **names):
    """Repeat a query until a member answers in time: on a busy machine, or while a robot starts."""

    def ask():
        try:
            return [wire.ask(*asked, **names)]
        except Refused as error:
            if error.args[0] in ("timeout", "nobody answers", "inactive", "busy"):
                return []
            raise

    return until(ask, asked[0])[0]


def drive(wire, states, robot):
    """Start the behavior `wander` of a robot, and print its distance from the start."""
    plugins = {plugin["name"]: plugin for plugin in patiently(wire, "robot_plugins", robot=robot)}
    start = next(function for function in plugins["wander"]["functions"] if function["name"] == "start")
    (duration,) = resolved(start["parameters"], start["parameters"])["properties"]
    call = {"robot": robot, "plugin": "wander", "function": start["name"]}
    route = []

    def came_m():
        if states[robot]["behavior"] == "wander":
            route.append((states[robot]["pose"]["x_m"], states[robot]["pose"]["y_m"]))
            return math.dist(route[0], route[-1])
        route.clear()
        patiently(wire, "robot_call", {duration: WANDER_S}, **call)  # its result is false if it has a task
        return 0.0

    until(lambda: came_m() > 0.2, f"{robot} has other things to do")
    print(f"{robot} wanders: {math.dist(route[0], route[-1]):.1f} m from its start")


def do_task(wire):
    """Submit a visit, and print its states until its end."""
    events, task_id = queue.Queue(), f"{ME}-{time.time_ns()}"
    wire.listen("task_event", lambda event: event["task"]["id"] == task_id and events.put(event))
    visit = wire.message({"$ref": "#/$defs/Task"}, kind="visit", id=task_id, place=PLACE, priority=100.0)
    submission = wire.message(wire.rows["task_submit"]["request"], task=visit, by=ME)
    record, states = patiently(wire, "task_submit", submission), []
    while record["state"] not in ("done", "failed", "cancelled"):
        try:
            record = events.get(timeout=5.0)
        except queue.Empty:  # an event may have been lost
            record = patiently(wire, "task_get", {"id": task_id})
        states += [record["state"]]
    print(f"the visit: {', '.join(dict.fromkeys(states))} by {record['robot']}")


def halt(wire, states, *, halted):
    """Halt all robots, or end their halt; repeated until all confirm it."""
    said = {"halted": halted, "by": ME, "reason": "an example"}
    until(
        lambda: all(state["halted"] is halted for state in states.values()),
        "not all robots confirm",
        step=lambda: wire.put("halt", **said),
    )
    print(f"{'halted' if halted else 'resumed'}: {', '.join(sorted(states))}")


def main():
    """Use the team at the given endpoint, with the document on standard input."""
    document = json.load(sys.stdin)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:2]))
    with zenoh.open(config) as session:
        wire, states = Wire(document, session), {}
        wire.listen("robot_state", lambda state: states.update({state["robot"]: state}))
        robots = until(lambda: sorted(token["robot"] for token in wire.present("robot_alive")), "there are no robots")
        until(lambda: all(states.get(robot, {}).get("pose") for robot in robots), "not all robots say where they are")
        for robot in robots:
            print(f"{robot} is at {states[robot]['pose']['x_m']:.1f}, {states[robot]['pose']['y_m']:.1f}")
        drive(wire, states, robots[0])
        do_task(wire)
        try:
            wire.ask("task_get", wire.message(wire.rows["task_get"]["request"], id="unheard-of"))
        except Refused as error:
            print(f"an unknown task: {error.args[0]}, {document['errors'][error.args[0]]}")
        halt(wire, states, halted=True)
        halt(wire, states, halted=False)


if __name__ == "__main__":
    main()
