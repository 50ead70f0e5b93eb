"""Templates: plain JSON with names in braces, which are replaced by values.

A text that is one name in braces becomes that value. Names in other texts are replaced by words. Braces have no other
meaning: no attributes, no formats, no code.
"""

import re
from collections.abc import Mapping
from typing import Any

import msgspec

from robrain.protocol.model.ranges import NAME_MAX, cut

Values = Mapping[str, Any]
"""Values of names: plain JSON."""
DEPTH_MAX = 8
_BRACES = re.compile(r"\{([^{}]*)\}")


def check_template(template: object, values: Values, depth: int = 0) -> None:
    """Check that a parameter can be filled (ValueError): plain JSON, in which braces have only known names."""
    if depth > DEPTH_MAX:
        raise ValueError(f"expected at most {DEPTH_MAX} levels of tables and lists")
    if isinstance(template, str):
        for name in _BRACES.findall(template):
            if name not in values:
                known = ", ".join(f"{{{each}}}" for each in values)
                raise ValueError(f"expected one of {known}, got {{{name}}}")
        rest = _BRACES.sub("", template)
        if "{" in rest or "}" in rest:
            raise ValueError(f"expected braces in pairs around a name, got {template!r}")
    elif isinstance(template, dict):
        for part in template.values():
            check_template(part, values, depth + 1)
    elif isinstance(template, list | tuple):
        for part in template:
            check_template(part, values, depth + 1)
    elif not isinstance(template, bool | int | float):
        got = type(template).__name__
        raise ValueError(f"expected a text, number, list or table, got a {got}")  # noqa: TRY004 - of a file


def check_templates(what: str, templates: Mapping[str, Any], values: Values) -> None:
    """Check each of some fields as `check_template` does (ValueError); the error names `what` and the field."""
    for name, template in templates.items():
        try:
            check_template(template, values)
        except ValueError as error:
            raise ValueError(f"{what}.{name}: {error}") from error


def fill(template: Any, values: Values) -> Any:
    """A parameter with the names in braces replaced.

    >>> fill({"mote": "{mote}", "note": "{value} at {mote}"}, {"mote": "m3", "value": 27.5})
    {'mote': 'm3', 'note': '27.5 at m3'}
    >>> fill("{value}", {"value": 27.5})
    27.5
    """
    if isinstance(template, str):
        alone = _BRACES.fullmatch(template)
        if alone is not None:
            return values[alone.group(1)]
        return _BRACES.sub(lambda found: _word(values[found.group(1)]), template)
    if isinstance(template, dict):
        return {name: fill(part, values) for name, part in template.items()}
    return [fill(part, values) for part in template] if isinstance(template, list | tuple) else template


def _word(value: Any) -> str:
    return cut(f"{value:g}" if isinstance(value, float) else str(value), NAME_MAX)


def names_in(template: object) -> set[str]:
    """The names in braces in a template."""
    return set(_BRACES.findall(msgspec.json.encode(template).decode()))
