"""Expectations of plain reasons: by their kind and values, not by their sentence."""

from robrain.protocol.reasons import PlainReason, Value


class Plain:
    """Equals each plain reason of a kind that has these values."""

    def __init__(self, kind: str, /, **values: Value) -> None:
        self.kind = kind
        self.values = values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, PlainReason):
            return NotImplemented
        return other.kind == self.kind and self.values.items() <= other.values.items()

    def __hash__(self) -> int:
        return hash(self.kind)

    def __repr__(self) -> str:
        return f"Plain({self.kind!r}, **{self.values!r})"
