"""The dashboard: the team in a browser, drawn by a Zenoh client like any other."""

from robrain.coordinator.dashboard.dashboard import Dashboard, run_dashboard
from robrain.coordinator.dashboard.replay.replay_source import ReplaySource
from robrain.coordinator.dashboard.state.team_view import TeamView

__all__ = ["Dashboard", "ReplaySource", "TeamView", "run_dashboard"]
