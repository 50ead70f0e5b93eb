"""Tools of an assistant that change nothing."""

import io
import math
from collections.abc import Sequence
from contextlib import closing
from typing import NamedTuple

from PIL import Image, ImageDraw

from robrain.client.submission import BadTask
from robrain.client.team import Team
from robrain.deploy.assistant.arguments import (
    Arguments,
    CallVerdict,
    ListTasks,
    NewTask,
    OfRobot,
    OfTask,
    ToolAnswer,
    answer,
)
from robrain.deploy.assistant.policy import OUTSIDE, Ban, CallRefused, call_refusal
from robrain.deploy.tasks.task_files import dry_run_lines, verdict_line
from robrain.protocol.clock import to_seconds
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.task_messages import TaskDryRun, TaskFilter, TaskRecord
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.drawing.palette import FREE, FRONTIER, HALTED, NOSE, OCCUPIED, TASK_WAITING, UNKNOWN, style_of

SIDE_PX = 900
"""Longer side of the picture."""
PX_PER_M_MAX = 60.0
MARGIN_M = 1.0
ROBOT_PX_MIN = 6.0
DRAWN_MAX = 200
"""Most robots, and most tasks, that are drawn."""
LABEL_MAX = 24
FAR_M = 10_000.0
"""Objects farther out are not drawn."""
STEPS_M = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)
LINES_MAX = 12
GRID = (120, 128, 140)
TEXT = (255, 255, 255)


class _Frame(NamedTuple):
    """From metres in the arena frame to pixels."""

    x0_m: float
    y1_m: float
    px_per_m: float

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m - self.x0_m) * self.px_per_m, (self.y1_m - y_m) * self.px_per_m


def map_png(floor: ComposedMap, robots: Sequence[RobotState], tasks: Sequence[TaskRecord]) -> bytes:
    """Draw the map.

    Args:
        floor: the team's knowledge; may be empty.
        robots: with poses in the arena frame; at most 200 of them are drawn.
        tasks: as robots; a cross is one that no robot has begun, a filled square one that a robot does.

    Returns:
        A PNG, its longer side at most 900 pixels, y upwards, with lines at whole metres and their coordinates.

    """
    placed = [(one, one.pose) for one in robots[:DRAWN_MAX] if one.pose is not None and _is_near(one.pose)]
    tasks = [one for one in tasks[:DRAWN_MAX] if _is_near(one.task.place)]
    xs_m, ys_m = [pose.x_m for _, pose in placed] or [0.0], [pose.y_m for _, pose in placed] or [0.0]
    bounds = floor.known_bounds_m() or (min(xs_m), min(ys_m), max(xs_m), max(ys_m))
    x0_m, y0_m, x1_m, y1_m = bounds[0] - MARGIN_M, bounds[1] - MARGIN_M, bounds[2] + MARGIN_M, bounds[3] + MARGIN_M
    px_per_m = min(PX_PER_M_MAX, SIDE_PX / max(x1_m - x0_m, y1_m - y0_m))
    frame = _Frame(x0_m, y1_m, px_per_m)
    size = max(1, round((x1_m - x0_m) * px_per_m)), max(1, round((y1_m - y0_m) * px_per_m))
    picture = Image.new("RGB", size, UNKNOWN)
    _draw_floor(picture, floor, frame)
    draw = ImageDraw.Draw(picture)
    _draw_scale(draw, frame, size)
    for task in tasks:
        _draw_task(draw, frame, task)
    for index, (robot, pose) in enumerate(placed):
        _draw_robot(draw, frame, robot, pose, index)
    written = io.BytesIO()
    picture.save(written, "PNG", optimize=True)
    return written.getvalue()


def _is_near(place: Point2D | Pose2D) -> bool:
    return abs(place.x_m) < FAR_M and abs(place.y_m) < FAR_M  # not of NaN


def _draw_floor(picture: Image.Image, floor: ComposedMap, frame: _Frame) -> None:
    drawn = floor.floor
    if drawn is None:
        return
    geometry = drawn.geometry
    cells = Image.fromarray(drawn.picture(UNKNOWN, FREE, OCCUPIED)[::-1])
    per_px = 1.0 / (frame.px_per_m * geometry.resolution_m)
    left = (frame.x0_m - geometry.origin_x_m) / geometry.resolution_m
    top = geometry.height - (frame.y1_m - geometry.origin_y_m) / geometry.resolution_m
    # An affine map from pixels of the picture to cells, which PIL fills with UNKNOWN outside of them.
    matrix = (per_px, 0.0, left, 0.0, per_px, top)
    shown = cells.transform(picture.size, Image.Transform.AFFINE, matrix, Image.Resampling.NEAREST, fillcolor=UNKNOWN)
    picture.paste(shown)


def _draw_scale(draw: ImageDraw.ImageDraw, frame: _Frame, size: tuple[int, int]) -> None:
    span_m = max(size) / frame.px_per_m
    step_m = next((step for step in STEPS_M if span_m / step <= LINES_MAX), STEPS_M[-1])
    first_m, last_m = math.ceil(frame.x0_m / step_m) * step_m, math.floor(frame.y1_m / step_m) * step_m
    for number in range(LINES_MAX + 1):
        x_m, y_m = first_m + number * step_m, last_m - number * step_m
        x_px, y_px = frame.at(x_m, y_m)
        draw.line([(x_px, 0), (x_px, size[1])], fill=GRID)
        draw.text((x_px + 2, size[1] - 12), f"{x_m:g}", fill=TEXT)
        draw.line([(0, y_px), (size[0], y_px)], fill=GRID)
        draw.text((2, y_px + 1), f"{y_m:g}", fill=TEXT)


def _draw_task(draw: ImageDraw.ImageDraw, frame: _Frame, record: TaskRecord) -> None:
    x_px, y_px = frame.at(record.task.place.x_m, record.task.place.y_m)
    if record.state is TaskState.RUNNING:
        draw.rectangle([x_px - 5, y_px - 5, x_px + 5, y_px + 5], fill=FRONTIER, outline=NOSE)
    else:
        for width, color in ((6, NOSE), (3, TASK_WAITING)):  # the outline first
            for one in (-1, 1):
                draw.line([(x_px - 6, y_px - 6 * one), (x_px + 6, y_px + 6 * one)], fill=color, width=width)
    _label(draw, (x_px + 8, y_px + 2), record.task.id)


def _draw_robot(draw: ImageDraw.ImageDraw, frame: _Frame, robot: RobotState, pose: Pose2D, index: int) -> None:
    x_px, y_px = frame.at(pose.x_m, pose.y_m)
    radius_px = max(ROBOT_PX_MIN, min(robot.radius_m, 5.0) * frame.px_per_m)
    color = HALTED if robot.halted else style_of(index).color
    draw.ellipse([x_px - radius_px, y_px - radius_px, x_px + radius_px, y_px + radius_px], fill=color, outline=NOSE)
    nose = x_px + radius_px * math.cos(pose.yaw_rad), y_px - radius_px * math.sin(pose.yaw_rad)
    draw.line([(x_px, y_px), nose], fill=NOSE, width=2)
    _label(draw, (x_px + radius_px + 2, y_px - 12), robot.robot)


def _label(draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str) -> None:
    plain = cut(text, LABEL_MAX).encode("ascii", "replace").decode()  # any installed font
    draw.text(at, plain, fill=TEXT, stroke_width=2, stroke_fill=NOSE)


MAP_TIMEOUT_S = 5.0
"""Of one robot's map."""
MAP_BUDGET_S = 10.0
"""After this no further robot is asked for its map and its place: a model does not wait for minutes."""
OPEN = [state for state in TaskState if not state.ended]
SHOWN_CHANGES = 20
OLD_S = 2.0
"""A state that is older than this is shown with its age; robots publish ten a second, coordinators two."""


def foreseen(found: TaskDryRun) -> dict[str, object]:
    """The consequences of a task as values."""
    return {name: getattr(found, name) for name in ("robots", "estimate", "delays", "remedies", "blocks")}


class TeamReader:
    """Tools that read a team's state.

    Args:
        team: a connection to it, used by one thread at a time.

    """

    def __init__(self, team: Team) -> None:
        self._team = team

    def list_robots(self, _: Arguments) -> ToolAnswer:
        """List the robots that are present, and what each of them does."""
        state = self._team.state()
        unknown = sorted(set(self._team.robots) - {one.name for one in state.robots})
        lines = [f"{name}: the coordinator does not know it yet" for name in unknown]
        robots: list[dict[str, object]] = [{"name": name} for name in unknown]
        for one in sorted(state.robots, key=lambda one: one.name):
            at_work = f"at task {one.task}" if one.task else one.behavior or "idle"
            doing = "absent" if not one.up else "halted" if one.halted else at_work
            charge = "" if one.soc is None else f", charge {one.soc:.0%}"
            lines.append(f"{one.name}: {doing}{charge}{f': {one.why}' if one.why else ''}")
            shown = ("name", "up", "halted", "task", "soc", "why")
            robots.append({name: getattr(one, name) for name in shown})
        lines = [*(lines or ["no robot is there"]), *self._age_lines(state.stamp_ns)]
        return answer(CallVerdict.READ, lines, {"robots": robots})

    def robot_state(self, asked: OfRobot) -> ToolAnswer:
        """Tell where a robot is, what it does, and how its battery and plugins are."""
        state = self._team.state(asked.robot)
        lines = [*_state_lines(state), *self._age_lines(state.stamp_ns)]
        return answer(CallVerdict.READ, lines, {"state": state, "age_s": self._age_s(state.stamp_ns)})

    def team_state(self, _: Arguments) -> ToolAnswer:
        """Tell how the whole team is: tasks, map, exploration, halt."""
        state = self._team.state()
        up = sum(one.up for one in state.robots)
        lines = [
            f"{up} of {len(state.robots)} robots are up",
            f"{state.tasks_open} tasks are open, {state.tasks_done} were done",
            f"{state.known_area_m2:.0f} m² are known; "
            + ("exploration is complete" if state.all_explored else f"{len(state.frontiers)} frontiers are left"),
        ]
        if state.halt is not None and state.halt.halted:
            lines.append(f"the team is halted by {', '.join(state.halt.by)}: {state.halt.reason or 'no reason given'}")
        lines += self._age_lines(state.stamp_ns)
        values = {"age_s": self._age_s(state.stamp_ns), "robots": len(state.robots), "robots_up": up}
        for name in ("halt", "tasks_open", "tasks_done", "known_area_m2", "all_explored"):
            values[name] = getattr(state, name)
        return answer(CallVerdict.READ, lines, values)

    def list_plugins(self, asked: OfRobot) -> ToolAnswer:
        """List a robot's plugins that are open to the outside, with the functions that call_plugin may call."""
        plugins = self._team.plugins(asked.robot)
        lines, found = [], []
        for one in plugins:
            open_functions = [
                function for function in one.functions if call_refusal(one.name, function.name, plugins) is None
            ]
            state = f"{one.name} ({one.level}): {one.state}{f', {one.why}' if one.why else ''}"
            lines.append(state if OUTSIDE in one.visibility else f"{state}, not open to the outside")
            lines += [f"  {function.name}{function.signature}" for function in open_functions]
            names = [function.name for function in open_functions]
            found.append({"name": one.name, "level": one.level, "state": one.state, "functions": names})
        return answer(CallVerdict.READ, lines, {"plugins": found})

    def list_kinds(self, _: Arguments) -> ToolAnswer:
        """List the kinds of task that robots of the team do, with their parameters."""
        kinds = self._team.kinds()
        lines = []
        for one in kinds:
            names = one.parameters.get("properties", {})
            needed = one.parameters.get("required", [])
            shown = ", ".join(name if name in needed else f"[{name}]" for name in names) or "none"
            lines.append(f"{one.kind}: {one.doc.partition(chr(10))[0]} parameters: {shown} ({', '.join(one.robots)})")
        found = [{"kind": one.kind, "parameters": one.parameters} for one in kinds]
        return answer(CallVerdict.READ, lines or ["no robot has announced its kinds yet"], {"kinds": found})

    def list_tasks(self, asked: ListTasks) -> ToolAnswer:
        """List tasks with their states, the coordinator's own left out."""
        records = self._team.list(TaskFilter(states=asked.states, limit=asked.limit))
        lines = [task_line(record) for record in records] or ["there are no such tasks"]
        tasks = [{"id": one.task.id, "state": one.state, "robot": one.robot, "by": one.by} for one in records]
        return answer(CallVerdict.READ, lines, {"tasks": tasks})

    def explain_task(self, asked: OfTask) -> ToolAnswer:
        """Explain how a task stands: what it waits for, what it would take each robot, what has happened so far."""
        explained = self._team.why(asked.task)
        lines = [f"{asked.task}: {explained.now}", *map(verdict_line, explained.robots)]
        changes = explained.changes[-SHOWN_CHANGES:]
        lines += [f"  then {change.state}: {change.why}" for change in changes if change.why]
        record = explained.record
        values = {name: getattr(record, name) for name in ("state", "robot", "by", "result")}
        values |= {"reason": explained.reason, "robots": explained.robots}
        return answer(CallVerdict.READ, lines, values)

    def dry_run(self, asked: NewTask) -> ToolAnswer:
        """Report the expected effects of a task, without submitting it."""
        found = self.foresee(asked)
        values = {"refused": found.refused, "waits": found.waits, **foreseen(found)}
        if found.refused:
            return answer(CallVerdict.REFUSED, dry_run_lines(found), values, code=Ban.TEAM)
        return answer(CallVerdict.READ, dry_run_lines(found), values)

    def foresee(self, asked: NewTask, task_id: str | None = None) -> TaskDryRun:
        """The coordinator's dry run of a task (Refused if it is no valid task)."""
        try:
            return self._team.dry_run(asked.kind, id=task_id, parameters=asked.fields)
        except BadTask as error:
            raise CallRefused(Ban.BAD_ARGUMENTS, str(error)) from error

    def show_map(self, _: Arguments) -> ToolAnswer:
        """Draw the map that the team knows, with robots (discs with a nose) and open tasks (crosses, squares)."""
        names = self._team.robots[:DRAWN_MAX]
        ends_s = self._team.transport.elapsed_s() + MAP_BUDGET_S
        floor, silent = self._floor(names, ends_s)
        states = [state for name in names if (state := self._state(name, ends_s)) is not None]
        robots = [one for one in states if one.pose is not None and one.frame == ARENA]
        tasks = self._team.list(TaskFilter(states=OPEN, limit=DRAWN_MAX))
        bounds_m = floor.known_bounds_m()
        lines = [f"{floor.known_area_m2:.0f} m² are known"]
        if bounds_m is not None:
            x0_m, y0_m, x1_m, y1_m = bounds_m
            lines.append(f"x from {x0_m:.1f} to {x1_m:.1f} m, y from {y0_m:.1f} to {y1_m:.1f} m, y upwards")
        lines += [f"{one.robot} at ({one.pose.x_m:.1f}, {one.pose.y_m:.1f})" for one in robots if one.pose is not None]
        lines += [f"task {one.task.id} at ({one.task.place.x_m:.1f}, {one.task.place.y_m:.1f})" for one in tasks]
        lines += [f"{name} does not send its map" for name in silent]
        return answer(CallVerdict.READ, lines, {"bounds_m": bounds_m}, png=map_png(floor, robots, tasks))

    def _age_s(self, stamp_ns: int) -> float:
        return round(self._team.now_s - to_seconds(stamp_ns), 1)

    def _age_lines(self, stamp_ns: int) -> list[str]:
        """That a message is old, if it is."""
        age_s = self._age_s(stamp_ns)
        return [f"this was said {age_s:.0f} s ago, and nothing since"] if age_s > OLD_S else []

    def _state(self, name: str, ends_s: float) -> RobotState | None:
        if self._team.transport.elapsed_s() > ends_s:
            return None
        try:
            return self._team.state(name)
        except NobodyThere:
            return None

    def _floor(self, names: Sequence[str], ends_s: float) -> tuple[ComposedMap, list[str]]:
        """The robots' maps, composed, and the robots that did not answer in time or whose map does not fit."""
        floor, silent = ComposedMap(), []
        transport = self._team.transport
        with closing(Endpoint(transport.session, transport.team, transport.clock, transport.drive)) as wire:
            for name in names:
                if transport.elapsed_s() > ends_s:
                    silent.append(name)
                    continue
                try:
                    patch = wire.ask(ROBOT_MAP_WHOLE, None, timeout_s=MAP_TIMEOUT_S, robot=name)
                    if patch is not None:
                        floor.merge(patch)
                except (CallError, NobodyThere, ValueError):
                    silent.append(name)
        return floor, silent


def task_line(record: TaskRecord) -> str:
    """A task in one line."""
    task = record.task
    at = f" at {record.robot}" if record.robot else ""
    reason = f": {record.why}" if record.why else ""
    where = f"({task.place.x_m:g}, {task.place.y_m:g})"
    return f"{task.id}: {task.kind} at {where}, {record.state}{at}, by {record.by or 'nobody'}{reason}"


def _state_lines(state: RobotState) -> list[str]:
    lines = [f"{state.robot}: {'halted' if state.halted else state.behavior or 'idle'}"]
    if state.pose is not None:
        where = "" if state.frame == ARENA else ", in a map frame of its own"
        lines.append(f"at ({state.pose.x_m:.2f}, {state.pose.y_m:.2f}) m, heading {state.pose.yaw_rad:.2f} rad{where}")
    if state.lost:
        lines.append(f"it has lost its position: {state.lost}")
    if state.task is not None:
        lines.append(f"its last task is {state.task.id}, {state.task.state}: {state.task.why or 'no remark'}")
    if state.battery is not None:
        charging = ", charging" if state.battery.charging else ""
        lines.append(f"battery {state.battery.soc:.0%}, {state.battery.remaining_j:.0f} J{charging}")
    lines += [f"plugin {fault.plugin} does not run: {fault.why}" for fault in state.faulted]
    return lines
