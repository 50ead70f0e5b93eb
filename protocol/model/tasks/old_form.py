"""Reads older forms of tasks and reasons in recordings and journals.

Each kind of task was a struct: its parameters stood beside the common fields, and the kind was the tag `type`. The
place of an `explore` was its `goal`. Each reason had a code, also those that no decision uses.
"""

import re
from typing import Any

import msgspec

from robrain.protocol.model.tasks.stock_kinds import STOCK_KINDS
from robrain.protocol.model.tasks.task import Task

TAG, GOAL = "type", "goal"
COMMON = frozenset(field.name for field in msgspec.structs.fields(Task))
_CODES = (
    "after_open|after_undone|after_unknown|after_unplanned|another_nearer|at_task|battery_too_small|"
    "best_together|cancelled|cannot_be_planned|carrier_out|charged_enough|charged_for_tasks|chargers_taken|"
    "charging|cheapest|contact_back|crowded|data_old|dearer|done_before|epoch_ahead|epoch_old|exploration_off|"
    "failed|far_from_place|forbidden|forgotten|gather|gave_up|halted|heads_home|holder_lacks|holder_late|"
    "holder_out|is_at_it|is_own|is_state|lacks_plugins|lost_contact|mote_cut_off|mote_ends|mote_heard|"
    "mote_silent|mote_unknown|needed_for|needs_time|never_taken|no_behavior|no_path|no_plan|no_robots|no_way|"
    "no_way_and_back|nobody_allowed|nobody_does|nobody_has|nobody_has_all|nobody_there|not_at_task|not_before|"
    "not_leading|not_offered|not_ready|not_together|not_together_for_it|not_worth_it|nothing_else|only_these|"
    "others_explore|outranked|part_failed|part_undone|parts_untold|place_unknown|plan_pending|plugin_out|"
    "position_unknown|refused_often|replaced|rule_event|rule_reading|senses_other|sent_to_charge|speaks_seldom|"
    "takes_over|task_soon|team_halted|team_lacks|to_begin|to_charge|told_nothing|too_few_robots|too_late|"
    "too_late_home|too_narrow|tried_in_vain|unexplored|unreachable|unreadable|waits_for_charger|waits_for_itself|"
    "waits_for_robot|whole_is|with_others"
)
PLAIN_REASONS = frozenset(_CODES.split("|"))
"""Codes of reasons that are a `PlainReason` today; the code is its `kind`."""
_OLD_REASON = re.compile(rb'"code":"(?:%s)"' % _CODES.encode())
REFUSED = "refused"
"""Field of states with counts of refused messages, whose codes are no reasons."""
WITHIN = ("because", "before")
"""Fields of reasons with another reason."""


def upgraded(content: Any) -> Any:
    """Convert a record with a `task` to today's form.

    Args:
        content: a decoded message, record or request.

    Returns:
        The same with its task in today's form; `content` itself if it holds no task of the old form.

    """
    task = content.get("task") if isinstance(content, dict) else None
    if not isinstance(task, dict) or "kind" in task or task.get(TAG) not in STOCK_KINDS:
        return content
    kind = task[TAG]
    own = {field.name for field in msgspec.structs.fields(STOCK_KINDS[kind])}
    today = {name: value for name, value in task.items() if name in COMMON} | {"kind": kind}
    if GOAL in task:
        today["place"] = task[GOAL]
    parameters = {name: value for name, value in task.items() if name in own}
    if parameters:
        today["parameters"] = parameters
    return {**content, "task": today}


def upgraded_json(payload: bytes) -> bytes:
    """The same of JSON, also with reasons of older forms; a payload without older forms is returned as it is."""
    has_task, has_reason = b'"task":{"type":' in payload, _OLD_REASON.search(payload) is not None
    if not (has_task or has_reason):
        return payload
    try:
        content = upgraded(msgspec.json.decode(payload))
        return msgspec.json.encode(_with_plain_reasons(content, "") if has_reason else content)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return payload


def _with_plain_reasons(value: Any, text: str) -> Any:
    """The value with each reason of an older form as a `PlainReason`; `text` is its sentence, if that is known."""
    if isinstance(value, list):
        return [_with_plain_reasons(one, "") for one in value]
    if not isinstance(value, dict):
        return value
    sentence = value.get("why") or value.get("why_not") or value.get("now") or ""
    inner = {
        name: part if name == REFUSED else _with_plain_reasons(part, "" if name in WITHIN else sentence)
        for name, part in value.items()
    }
    code = inner.get("code")
    if code not in PLAIN_REASONS:
        return inner
    values = {name: part for name, part in inner.items() if name != "code" and isinstance(part, str | int | float)}
    plain = {"code": "said", "text": text or str(code).replace("_", " "), "kind": code}
    return {**plain, "values": values} if values else plain
