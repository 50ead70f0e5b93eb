"""What a rule waits for, in words for people."""

from robrain.coordinator.rules.rule import EventCondition, ReadingCondition, Rule

NAMED = 3
"""Most motes or robots listed by name; longer lists end with the number of the rest."""


def waits_for(rule: Rule) -> str:
    """The condition of a rule and the kind of its task, as a phrase.

    >>> from robrain.coordinator.rules.rule import TaskOrder
    >>> heat = ReadingCondition(quantity="temperature_c", above=26.0, for_s=10.0, clear_at=24.0)
    >>> waits_for(Rule(name="heat", reading=heat, task=TaskOrder(kind="visit")))
    'temperature_c above 26 for 10 s; then visit'
    """
    condition = rule.reading if rule.reading is not None else rule.event
    assert condition is not None
    what = _reading(condition) if isinstance(condition, ReadingCondition) else _event(condition)
    return f"{what}; then {rule.task.kind}"


def _reading(condition: ReadingCondition) -> str:
    held = f" for {condition.for_s:g} s" if condition.for_s else ""
    if condition.is_rate:
        verb = "rising" if condition.comparison == "rising_per_min" else "falling"
        how = f"{verb} by more than {condition.threshold:g} per minute"
    else:
        how = f"{condition.comparison} {condition.threshold:g}"
    of_motes, by_robots = _of(condition.motes, "of", "motes"), _of(condition.robots, "heard by", "robots")
    area = condition.area
    where = (
        ""
        if area is None
        else f" within x {area.x_min_m:g} to {area.x_max_m:g} m, y {area.y_min_m:g} to {area.y_max_m:g} m"
    )
    return f"{condition.quantity}{of_motes} {how}{held}{by_robots}{where}"


def _event(condition: EventCondition) -> str:
    part = f" {condition.field}" if condition.field else ""
    sides = [
        f"{side} {value:g}"
        for side, value in (("above", condition.above), ("below", condition.below))
        if value is not None
    ]
    value = f" with{part or ' a value'} {' and '.join(sides)}" if sides else ""
    return f"{condition.event} of {condition.plugin}{_of(condition.robots, 'on', 'robots')}{value}"


def _of(names: tuple[str, ...], word: str, many: str) -> str:
    if not names:
        return ""
    return f" {word} {', '.join(names)}" if len(names) <= NAMED else f" {word} {len(names)} {many}"
