"""The dashboard: the team in a browser, drawn by a Zenoh client like any other."""

from robrain.dashboard.dashboard import Dashboard, run_dashboard
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.state.shown_team import ShownTeam

__all__ = ["Dashboard", "ReplaySource", "ShownTeam", "run_dashboard"]
