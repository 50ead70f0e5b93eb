"""The mote field and the rules, as HTML. Every string from the wire is escaped."""

from robrain.dashboard.html.html_words import NONE, text, tile
from robrain.dashboard.state.team_view import TeamView
from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.motes.mote_field_messages import GatewayCount, MoteFieldState
from robrain.protocol.messages.tasks.rule_messages import RuleStatus
from robrain.recording.drawing.time_span import span_text

WELL, POOR = 0.95, 0.8
"""Thresholds of the delivery ratio and of the coverage: good from the first, bad below the second (chosen)."""
RULES = 50
GATEWAYS = 20
FORWARDERS = 6


def field_html(view: TeamView) -> str:
    """How the mote field is doing, as figures; empty if the coordinator does not manage it."""
    field = view.team.mote_field if view.team is not None else None
    if view.team is None or not isinstance(field, MoteFieldState):
        return ""
    stamp_ns = view.team.stamp_ns
    living = field.motes - field.dead
    tiles = [
        tile("Delivered", "field-delivered", f"{100 * field.delivery_ratio:.0f} %", _kind(field.delivery_ratio)),
        tile("Floor covered", "field-covered", f"{100 * field.coverage:.0f} %", _kind(field.coverage)),
        tile("Age of data", "field-age", span_text(field.age_s)),
        tile("Oldest", "field-oldest", span_text(field.oldest_s)),
        tile("Motes alive", "field-alive", f"{living} of {field.motes}", "bad" if field.dead else ""),
        tile("First dead", "field-first-dead", _ago(field.first_dead_ns, stamp_ns)),
        tile("Half dead", "field-half-dead", _ago(field.half_dead_ns, stamp_ns)),
        tile("All dead", "field-last-dead", _ago(field.last_dead_ns, stamp_ns)),
    ]
    if field.on_duty < living:
        tiles.insert(5, tile("On duty", "field-duty", f"{field.on_duty} of {living}"))
    ways = _forwarders(field) + _gateways(field, stamp_ns)
    return f'<div class="rb"><div class="rb-tiles">{"".join(tiles)}</div>{ways}</div>'


def rules_html(view: TeamView) -> str:
    """What each rule waits for and what it has made; empty without rules."""
    team = view.team
    if team is None or not isinstance(team.rules, list) or not team.rules:
        return ""
    head = (
        '<tr><th style="width: 34%">Rule</th><th class="rb-number" style="width: 16%">In alarm</th>'
        '<th class="rb-number" style="width: 14%">Made</th><th class="rb-number" style="width: 14%">Open</th>'
        '<th class="rb-number" style="width: 22%">Last</th></tr>'
    )
    rows = "".join(_rule_rows(rule, team.stamp_ns) for rule in team.rules[:RULES])
    more = f'<div class="rb-none">and {len(team.rules) - RULES} more</div>' if len(team.rules) > RULES else ""
    return f'<div class="rb"><table data-testid="rules">{head}{rows}</table>{more}</div>'


def _rule_rows(rule: RuleStatus, stamp_ns: int) -> str:
    name = text(rule.name, 60)
    shape, kind = ("▲", "warn") if rule.alarms else ("○", "soft")
    alarms = f'<b class="rb-warn">{rule.alarms}</b>' if rule.alarms else "0"
    why = f'<br><span class="rb-bad">{rule.refused} refused: {text(rule.why)}</span>' if rule.refused else ""
    waits = text(rule.waits, 200) or NONE
    return (
        f'<tr class="rb-top"><td title="{name}"><span class="rb-{kind}">{shape}</span> <b>{name}</b></td>'
        f'<td class="rb-number" data-testid="rule-{name}-alarms">{alarms}</td>'
        f'<td class="rb-number" data-testid="rule-{name}-made">{rule.made}</td>'
        f'<td class="rb-number" data-testid="rule-{name}-open">{rule.open}</td>'
        f'<td class="rb-number">{_ago(rule.last_ns or None, stamp_ns)}</td></tr>'
        f'<tr class="rb-why"><td colspan="5" data-testid="rule-{name}-waits">{waits}{why}</td></tr>'
    )


def _forwarders(field: MoteFieldState) -> str:
    if not field.forwarders or not field.forwarded or not field.hops:
        return ""
    chips = "".join(
        f'<span class="rb-chip"><b>{text(one.mote, 40)}</b> {one.readings}</span>'
        for one in field.forwarders[:FORWARDERS]
    )
    left = len(field.forwarders) - FORWARDERS
    more = f'<span class="rb-soft">and {left} more</span>' if left > 0 else ""
    return (
        "<h4>Passed on by motes</h4>"
        f'<div data-testid="field-forwarded">{field.forwarded} readings, {field.hops:.1f} times each; first by</div>'
        f'<div class="rb-chips">{chips}{more}</div>'
    )


def _gateways(field: MoteFieldState, stamp_ns: int) -> str:
    if not field.gateways:
        return ""
    head = (
        '<tr><th style="width: 28%">Gateway</th><th class="rb-number" style="width: 18%">Told</th>'
        '<th class="rb-number" style="width: 16%">Stores</th><th class="rb-number" style="width: 16%">Dropped</th>'
        '<th class="rb-number" style="width: 22%">Heard</th></tr>'
    )
    rows = "".join(_gateway_row(one, stamp_ns) for one in field.gateways[:GATEWAYS])
    left = len(field.gateways) - GATEWAYS
    more = f'<div class="rb-none">and {left} more</div>' if left > 0 else ""
    return f'<h4>Gateways</h4><table data-testid="gateways">{head}{rows}</table>{more}'


def _gateway_row(one: GatewayCount, stamp_ns: int) -> str:
    name = text(one.name, 40)
    dropped = f'<b class="rb-bad">{one.dropped}</b>' if one.dropped else "0"
    stores = f'<b class="rb-warn">{one.waiting}</b>' if one.waiting else "0"
    return (
        f'<tr class="rb-top"><td><b>{name}</b></td>'
        f'<td class="rb-number" data-testid="gateway-{name}-told">{one.readings}</td>'
        f'<td class="rb-number" data-testid="gateway-{name}-stores">{stores}</td>'
        f'<td class="rb-number" data-testid="gateway-{name}-dropped">{dropped}</td>'
        f'<td class="rb-number">{_ago(one.heard_ns, stamp_ns)}</td></tr>'
    )


def _kind(share: float) -> str:
    return "good" if share >= WELL else "warn" if share >= POOR else "bad"


def _ago(then_ns: int | None, now_ns: int) -> str:
    return NONE if then_ns is None else f"{span_text(max(0.0, to_seconds(now_ns - then_ns)))} ago"
