"""The dashboard: the team in a browser, drawn by a Zenoh client like any other."""

from robrain.dashboard.dashboard import Dashboard, run_dashboard
from robrain.dashboard.replay.replay_source import ReplaySource
from robrain.dashboard.state.team_view import TeamView

__all__ = ["Dashboard", "ReplaySource", "TeamView", "run_dashboard"]
