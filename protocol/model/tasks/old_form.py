"""Reads older forms of messages, tasks and reasons in recordings and journals.

Fields of messages had other names. Each kind of task was a struct: its parameters stood beside the common fields, and
the kind was the tag `type`. The place of an `explore` was its `goal`. Each reason had a code, also those that no
decision uses.
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
RENAMED = {
    "at_mate": "at_other",
    "changes_heard": "changes_received",
    "goes_on": "continues",
    "goes_on_s": "continues_for_s",
    "heard": "received",
    "heard_ns": "last_seen_ns",
    "hears": "receives",
    "hears_coordinator": "receives_coordinator",
    "left_out": "skipped",
    "left_s": "remaining_s",
    "mate": "other_robot",
    "mate_submap": "other_submap",
    "taken_ns": "measured_ns",
    "took_s": "duration_s",
    "way_m": "path_length_m",
    "way_ratio": "path_ratio",
    "ways_cm": "paths_cm",
    "ways_deltas": "path_deltas",
    "why_not": "refusal",
}
"""Fields of messages by their former name. No message has one of the former names today."""
RENAMED_CODES = {"minority_heard": "minority_reached", "not_heard": "no_state", "stood_still": "process_paused"}
"""Codes of reasons by their former name."""
FREE = frozenset(("parameters", "result", "returns", "value"))
"""Fields of free JSON, whose contents are not those of messages."""
_OLD = re.compile(
    f'"task":\\{{"type":|"code":"(?:{_CODES}|{"|".join(RENAMED_CODES)})"|"(?:{"|".join(RENAMED)})":'.encode()
)
REFUSED = "refused"
"""Field of states with counts of refused messages, whose codes are no reasons."""
WITHIN = ("because", "before")
"""Fields of reasons with another reason."""


def upgraded_json(payload: bytes) -> bytes:
    """The JSON in today's form: names of fields, tasks and reasons; without older forms it is returned as it is."""
    if _OLD.search(payload) is None:
        return payload
    try:
        return msgspec.json.encode(upgraded(msgspec.json.decode(payload)))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return payload


def upgraded(value: Any, sentence: str = "") -> Any:
    """A decoded message, record or request in today's form.

    Args:
        value: the message, or a part of it.
        sentence: the text of a reason; empty if it is not known.

    """
    if isinstance(value, list):
        return [upgraded(one) for one in value]
    if not isinstance(value, dict):
        return value
    content: dict[str, Any] = {RENAMED.get(name) or name: part for name, part in value.items()}
    text = content.get("why") or content.get("refusal") or content.get("now") or ""
    for name, part in content.items():
        if name == "task":
            content[name] = _upgraded_task(upgraded(part))
        elif name == "code" and isinstance(part, str):
            content[name] = RENAMED_CODES.get(part, part)
        elif name not in FREE and name != REFUSED:
            content[name] = upgraded(part, "" if name in WITHIN else text)
    code = content.get("code")
    return _upgraded_reason(content, sentence) if isinstance(code, str) and code in PLAIN_REASONS else content


def _upgraded_task(task: Any) -> Any:
    """A task, which had its kind as a tag and its parameters beside the common fields."""
    if not isinstance(task, dict) or "kind" in task or task.get(TAG) not in STOCK_KINDS:
        return task
    kind = task[TAG]
    own = {field.name for field in msgspec.structs.fields(STOCK_KINDS[kind])}
    today = {name: value for name, value in task.items() if name in COMMON} | {"kind": kind}
    if GOAL in task:
        today["place"] = task[GOAL]
    parameters = {name: value for name, value in task.items() if name in own}
    return today | {"parameters": parameters} if parameters else today


def _upgraded_reason(reason: dict[str, Any], sentence: str) -> dict[str, Any]:
    """A reason that no decision uses, in its former form with a code and fields."""
    code = reason["code"]
    values = {name: part for name, part in reason.items() if name != "code" and isinstance(part, str | int | float)}
    plain = {"code": "said", "text": sentence or str(code).replace("_", " "), "kind": code}
    return {**plain, "values": values} if values else plain
