"""The tab of the selected robot: its state, driving by hand, calls to its plugins, charts and events."""

import time
from collections.abc import Callable
from typing import Any

import msgspec
import viser

from robrain.dashboard.html.charts import RobotCharts
from robrain.dashboard.html.elements import render
from robrain.dashboard.html.robot_html import (
    events_html,
    function_html,
    plugin_card_html,
    plugins_html,
    result_html,
    robot_card_html,
)
from robrain.dashboard.panels.function_form import FormPanel, fields_of
from robrain.dashboard.panels.gui_values import on_choice, set_html, set_options, set_value
from robrain.dashboard.panels.page import Page, RobotPlugins, RowActions, Tab
from robrain.dashboard.server.hand_pilot import HandPilot
from robrain.protocol.messages.robots.host_messages import (
    HOST_LOAD,
    HOST_RELOAD,
    HOST_UNLOAD,
    LoadRequest,
    ReloadRequest,
    UnloadRequest,
)
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, FunctionInfo, PluginInfo
from robrain.protocol.model.geometry import Twist2D
from robrain.protocol.model.zone import hand_warning
from robrain.protocol.topic import Query
from robrain.recording.drawing.labels import natural_key

HOLD_HZ = 40.0


TURN_PER_SPEED = 2.5
"""Turning rate, rad/s, for each m/s of the chosen speed."""
PUSHES: tuple[tuple[str, Twist2D], ...] = (
    ("Forward (W)", Twist2D(forward_m_s=1.0)),
    ("Back (S)", Twist2D(forward_m_s=-1.0)),
    ("Turn left (A)", Twist2D(yaw_rad_s=TURN_PER_SPEED)),
    ("Turn right (D)", Twist2D(yaw_rad_s=-TURN_PER_SPEED)),
    ("Left (Q)", Twist2D(left_m_s=1.0)),
    ("Right (E)", Twist2D(left_m_s=-1.0)),
)
"""Buttons, and the velocity of each for every m/s of the chosen speed."""


class HandDrive:
    """The controls of one page; built within a folder's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._armed = gui.add_checkbox("Armed", False, hint="While armed, W A S D Q E drive the selected robot")
        self._armed.on_update(lambda _: page.post(self._arm))
        self._speed = gui.add_slider(
            "Speed (m/s)", 0.05, 0.6, 0.05, 0.25, hint="The robot's hand_speed_m_s is the limit"
        )
        self._status = gui.add_html("")
        self._pilot: HandPilot | None = None
        self._shown = ""
        self._buttons = []
        for label, push in PUSHES:
            button = gui.add_button(label, disabled=True)
            self._buttons.append(button)
            button.on_hold(self._holder(label, push), HOLD_HZ)
        self._arm()

    def release(self) -> None:
        """Disarm, and give the robot back."""
        if self._armed.value or self._pilot is not None:
            set_value(self._armed, False)
            self._arm()

    def step(self) -> None:
        """Show the state of the drive; it continues without this."""
        pilot = self._pilot
        if pilot is None or not pilot.status:
            return
        reported, warning = pilot.status, self._warning(pilot.robot)
        if reported + warning == self._shown:
            return
        self._shown = reported + warning
        if warning:
            self._show(f"▲ {warning}", "warn")
        elif pilot.has_failed:
            self._show(f"✕ {pilot.robot}: {reported}", "bad")
        else:
            self._show(f"{'■' if reported == 'stopped' else '▶'} {pilot.robot} {reported}")

    def _warning(self, robot: str) -> str:
        """Which zone the person breaks who drives the robot, in words; empty if none."""
        view = self._page.context.view
        state = view.robots[robot].state if robot in view.robots else None
        if state is None or state.pose is None:
            return ""
        return hand_warning(view.zones.zones, robot, state.pose, state.velocity)

    def _arm(self) -> None:
        page, armed = self._page, bool(self._armed.value)
        for button in self._buttons:
            button.disabled = not armed
        if self._pilot is not None:
            self._pilot.end()
            self._pilot = None
        if armed and page.selected:
            self._pilot, self._shown = page.context.pilot(page.selected, page.client.client_id), ""
        self._show("Armed: hold a button or a key." if armed else "Not armed.")

    def _show(self, words: str, kind: str = "") -> None:
        html = render("robot", "hand_drive", is_armed=bool(self._armed.value), kind=kind, words=words)
        set_html(self._status, html)

    def _holder(self, label: str, push: Twist2D) -> Callable[[viser.GuiEvent[viser.GuiButtonHandle]], None]:
        def hold(_: object) -> None:  # on viser's thread: the page's own step may take longer than a lease
            pilot, speed_m_s = self._pilot, float(self._speed.value)
            if pilot is not None:
                velocity = Twist2D(speed_m_s * push.forward_m_s, speed_m_s * push.left_m_s, speed_m_s * push.yaw_rad_s)
                pilot.press(label, velocity, time.monotonic())

        return hold


NO_ROBOT = "(none)"
NO_PLUGIN, NO_FUNCTION = "(select a plugin)", "(none)"
CHART_PERIOD_S = 2.0
CALL_TIMEOUT_S = 15.0
HOST_VERBS: dict[str, tuple[Query[Any, list[PluginInfo]], type[Any]]] = {
    "load": (HOST_LOAD, LoadRequest),
    "unload": (HOST_UNLOAD, UnloadRequest),
    "reload": (HOST_RELOAD, ReloadRequest),
}


class RobotTab(Tab):
    """The tab of one page."""

    title, icon = "Robot", viser.Icon.ROBOT

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._plugin = ""
        self._function: FunctionInfo | None = None
        self._drawn_plugins: tuple[list[PluginInfo], str, str] | None = None
        self._charted_s: float | None = None
        self._choice = gui.add_dropdown("Robot", (NO_ROBOT,))
        on_choice(self._choice, lambda name: page.post(lambda: page.select(name)))
        self._card = gui.add_html(render("elements", "message", kind="none", words="No robot has been heard yet."))
        live = page.context.is_live
        with gui.add_folder("Drive by hand", expand_by_default=False, visible=live):
            self._drive = HandDrive(page)
        with gui.add_folder("Call a function", visible=live):
            self._callable = gui.add_dropdown("Plugin", (NO_PLUGIN,))
            on_choice(self._callable, lambda name: page.post(lambda: self.select_plugin(name)))
            self._functions = gui.add_dropdown("Function", (NO_FUNCTION,))
            self._functions.on_update(lambda event: page.post(lambda: self._choose_function(event.target.value)))
            self._doc = gui.add_html("")
            self._slot = gui.add_folder("Arguments", visible=False)
            self._form = FormPanel(gui, self._slot)
            self._call = gui.add_button("Call", color="blue", disabled=True)
            self._call.on_click(lambda _: page.post(self._call_function))
            self._result = gui.add_html("")
        with gui.add_folder("Plugins", visible=live):
            self._plugins = gui.add_html(plugins_html([], "", ""))
            self._plugin_card = gui.add_html(plugin_card_html(None))
            verbs = gui.add_button_group("Selected", ("Reload", "Unload"))
            verbs.on_click(lambda event: page.post(lambda: self._ask_host(event.target.value.lower(), self._plugin)))
            self._to_load = gui.add_text("Name or path", "", hint="A plugin's name, or a folder on the robot's machine")
            load = gui.add_button("Load")
            load.on_click(lambda _: page.post(lambda: self._ask_host("load", self._to_load.value.strip())))
        with gui.add_folder("Charts", expand_by_default=False):
            self._charts = RobotCharts(gui)
        with gui.add_folder("Events", expand_by_default=False):
            self._events = gui.add_html("")

    def hurry(self) -> None:
        """Update the charts at the next `draw`, even if that is before they are due."""
        self._charted_s = None

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        page = self._page
        view = page.context.view
        names = tuple(sorted(view.robots, key=natural_key))
        if names:
            set_options(self._choice, names, page.selected)
        robot = view.robots.get(page.selected)
        if robot is None:
            return
        set_html(self._card, robot_card_html(view, robot, now_s))
        set_html(self._events, events_html(robot))
        if self._charted_s is None or now_s - self._charted_s >= CHART_PERIOD_S:
            self._charted_s = now_s
            self._charts.draw(robot.history)
        if page.context.is_live:
            self._draw_plugins(page.context.inquiries.plugins_of(robot.name))

    def step(self) -> None:
        """Show how driving by hand goes."""
        self._drive.step()

    def row_actions(self) -> RowActions:
        """`plugin` selects a plugin."""
        return {"plugin": self.select_plugin}

    def handle_selection(self) -> None:
        """Show another robot, and release the one that was driven."""
        self._charted_s = None
        self._drawn_plugins = None
        self._drive.release()

    def close(self) -> None:
        """Release the robot that was driven."""
        self._drive.release()

    def select_plugin(self, name: str) -> None:
        """Show a plugin of the selected robot, and offer its functions."""
        self._plugin = "" if name == NO_PLUGIN else name
        self._drawn_plugins = None
        self._offer_functions()

    def _offer_functions(self) -> None:
        plugin = self._selected_plugin()
        names = tuple(function.name for function in plugin.functions) if plugin is not None else ()
        names = names or (NO_FUNCTION,)
        set_options(self._functions, names, names[0])
        self._choose_function(names[0])

    def _draw_plugins(self, known: RobotPlugins) -> None:
        state = (known.plugins, self._plugin, known.problem)
        if state == self._drawn_plugins:
            return
        self._drawn_plugins = state
        plugin = self._selected_plugin()
        set_html(self._plugins, plugins_html(*state))
        set_html(self._plugin_card, plugin_card_html(plugin))
        if self._plugin and known.plugins and plugin is None:  # it was unloaded, or this robot has no such plugin
            self._plugin = ""
            self._offer_functions()
        names = sorted(plugin.name for plugin in known.plugins if plugin.functions or plugin.name == self._plugin)
        set_options(self._callable, (NO_PLUGIN, *names), self._plugin if self._plugin in names else NO_PLUGIN)

    def _selected_plugin(self) -> PluginInfo | None:
        known = self._page.context.inquiries.plugins_of(self._page.selected)
        return next((plugin for plugin in known.plugins if plugin.name == self._plugin), None)

    def _choose_function(self, name: str) -> None:
        plugin = self._selected_plugin()
        functions = plugin.functions if plugin is not None else []
        function = self._function = next((function for function in functions if function.name == name), None)
        fields = fields_of(function.parameters) if function is not None else []
        self._form.show(fields)
        self._slot.visible = bool(fields)
        self._call.disabled = function is None
        set_html(self._doc, function_html(function) if function is not None else "")
        set_html(self._result, "")

    def _call_function(self) -> None:
        function, plugin, robot = self._function, self._plugin, self._page.selected
        if function is None:
            return
        what = f"{plugin}.{function.name}"
        try:
            arguments = msgspec.json.encode(self._form.arguments())
        except ValueError as error:
            set_html(self._result, result_html(what, b"", str(error)))
            return
        set_html(self._result, render("elements", "message", kind="soft", words=f"{what} was asked …"))

        def show(reply: bytes | None, error: str) -> None:
            if self._function is function and self._page.selected == robot:
                set_html(self._result, result_html(what, reply or b"", error))
            elif error:
                self._page.notify(f"{robot}: {what}", error=error)

        names = {"robot": robot, "plugin": plugin, "function": function.name}
        self._page.context.asker.ask(ROBOT_CALL, arguments, show, timeout_s=CALL_TIMEOUT_S, **names)

    def _ask_host(self, verb: str, plugin: str) -> None:
        robot, context = self._page.selected, self._page.context
        if not plugin or not robot:
            self._page.notify(f"Nothing to {verb}", "Select a robot, and a plugin or its name.", color="yellow")
            return

        def show(_: list[PluginInfo] | None, error: str) -> None:
            self._page.notify(f"{robot}: {verb} {plugin}", "done", error=error)
            if verb == "unload" and not error:
                set_value(self._to_load, plugin)  # so that one click loads it again
            context.inquiries.ask_again(robot)

        topic, request = HOST_VERBS[verb]
        context.asker.ask(topic, request(plugin=plugin), show, timeout_s=topic.timeout_s, robot=robot)
