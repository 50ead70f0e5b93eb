"""The generated pages, and what writes each."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from robrain.agent.plugin import Level
from robrain.protocol.schema.page import wire_page
from tests.reference_pages.api import plugin_api_page, python_page
from tests.reference_pages.commands import commands_page, recording_commands_page
from tests.reference_pages.decisions import decisions_page
from tests.reference_pages.files import manifests_page, planning_page, robot_files_page, scenarios_page, team_files_page
from tests.reference_pages.robot_contract import robot_contract_page
from tests.reference_pages.stock_plugins import stock_plugins_page

DOCS = Path(__file__).parents[2] / "docs"
GROUPS = ("task", "mission", "rule", "zone", "robot", "plugin", "journal", "pki", "ros2", "vda5050", "bench")
"""Groups of commands with a page of their own."""
PAGES: dict[str, Callable[[], str]] = {
    "reference/commands.md": commands_page,
    "reference/commands-recordings.md": recording_commands_page,
    **{f"reference/commands-{group}.md": partial(commands_page, group) for group in GROUPS},
    "reference/topics.md": wire_page,
    "reference/robot-contract.md": robot_contract_page,
    "reference/robot-files.md": robot_files_page,
    "reference/team-files.md": team_files_page,
    "reference/manifests.md": manifests_page,
    **{f"reference/stock-{level.name.lower()}s.md": partial(stock_plugins_page, level) for level in Level},
    "reference/scenarios.md": scenarios_page,
    "reference/planning.md": planning_page,
    "reference/python.md": python_page,
    "reference/plugin-api.md": plugin_api_page,
    "explanation/decisions.md": decisions_page,
}
"""Path below docs/ and the function that returns the page's whole text."""
