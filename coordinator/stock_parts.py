"""The list of robrain's own coordinator parts; entry points of other distributions add theirs (`core/part.py`)."""

from collections.abc import Sequence
from functools import partial

from robrain.coordinator.backups import Backups
from robrain.coordinator.charging.charging import Charging
from robrain.coordinator.core.core import PartFactory
from robrain.coordinator.exploration import Exploration
from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.leadership import ElectedLeadership, Leadership
from robrain.coordinator.motes.mote_field import FieldKeeper
from robrain.coordinator.motes.mote_members import MoteMembers
from robrain.coordinator.rules.rule import Rule
from robrain.coordinator.rules.task_rules import TaskRules


def stock_parts(rules: Sequence[Rule] = (), elected: Elected | None = None) -> list[PartFactory]:
    """Robrain's parts, in the order in which they are called."""
    return [
        partial(TaskRules, rules=rules),
        MoteMembers,
        FieldKeeper,
        Charging,
        Exploration,
        Backups,
        Leadership if elected is None else partial(ElectedLeadership, elected=elected),
    ]
