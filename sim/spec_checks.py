"""Checks of a specification's fields where it is built: ValueError with the field's name and value."""

import math

import msgspec


def check_above_zero(spec: msgspec.Struct, *names: str, finite: bool = False) -> None:
    """Fields above 0, and not infinite if `finite`."""
    for name in names:
        value = getattr(spec, name)
        if not value > 0 or (finite and value == math.inf):
            raise ValueError(f"expected {name} > 0, got {value}")


def check_not_negative(spec: msgspec.Struct, *names: str, finite: bool = False) -> None:
    """Fields from 0, and not infinite if `finite`."""
    for name in names:
        value = getattr(spec, name)
        if not value >= 0 or (finite and value == math.inf):
            raise ValueError(f"expected {name} >= 0, got {value}")


def check_within(spec: msgspec.Struct, least: float, most: float, *names: str) -> None:
    """Fields from `least` to `most`, both included."""
    for name in names:
        if not least <= getattr(spec, name) <= most:
            raise ValueError(f"expected {name} from {least} to {most}, got {getattr(spec, name)}")
