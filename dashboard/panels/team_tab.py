"""The tab of the team: figures, robots, exploration, motes, missions, rules and log."""

import numpy as np
import viser

from robrain.dashboard.html.charts import add_chart
from robrain.dashboard.html.team_html import (
    field_html,
    left_html,
    log_html,
    missions_html,
    robots_html,
    rules_html,
    summary_html,
)
from robrain.dashboard.panels.gui_values import set_html, set_visible
from robrain.dashboard.panels.page import Page, Tab

CHART_PERIOD_S = 2.0
MANY_ROWS = 25
LIST_PERIOD_S = 2.5
"""Period of a longer table, which costs a browser more than the picture."""
FOLDERS = {"Left to explore": left_html, "Mote field": field_html, "Missions": missions_html, "Rules": rules_html}
"""Folders by title, with their contents; those without content are hidden."""


class TeamTab(Tab):
    """The tab of one page."""

    title, icon = "Team", viser.Icon.USERS

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._summary = gui.add_html("")
        self._robots = gui.add_html("")
        self._folder = gui.add_folder("Explored over time", visible=False)
        with self._folder:
            self._chart = add_chart(gui, "Explored (%)", ["explored"], (0.0, 100.0))
        self._folders = []
        for title, content in FOLDERS.items():
            folder = gui.add_folder(title, visible=False)
            with folder:
                self._folders.append((folder, gui.add_html(""), content))
        with gui.add_folder("Log", expand_by_default=False):
            self._log = gui.add_html("")
        self._charted_s: float | None = None
        self._listed_s: float | None = None
        self._listed: tuple[str, int] | None = None

    def hurry(self) -> None:
        """Update everything at the next `draw`, even if that is before it is due."""
        self._charted_s = self._listed_s = None

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        view = self._page.context.view
        set_html(self._summary, summary_html(view, now_s))
        shown = (self._page.selected, len(view.robots))
        due = self._listed_s is None or now_s - self._listed_s >= LIST_PERIOD_S
        if due or shown != self._listed or len(view.robots) <= MANY_ROWS:
            self._listed_s, self._listed = now_s, shown
            set_html(self._robots, robots_html(view, now_s, self._page.selected))
        for folder, shown_html, content in self._folders:
            html = content(view)
            set_visible(folder, bool(html))
            set_html(shown_html, html)
        set_html(self._log, log_html(view))
        if len(view.explored) > 1 and (self._charted_s is None or now_s - self._charted_s >= CHART_PERIOD_S):
            self._charted_s = now_s
            self._folder.visible = True
            time_s, fraction = np.array(view.explored).T
            self._chart.data = (time_s, 100 * fraction)
