"""Output of commands: results on stdout, progress and warnings on stderr, each line at once and harmless."""

import sys
from collections.abc import Callable, Iterable


def print_result(text: str) -> None:
    """Print a line of the command's result on stdout; the lines of a longer text are indented."""
    from robrain.protocol.safe_text import safe_lines

    sys.stdout.write(safe_lines(text, "  ") + "\n")
    sys.stdout.flush()


def print_message(text: str) -> None:
    """Print a line about progress on stderr; the lines of a longer text are indented."""
    from robrain.protocol.safe_text import safe_lines

    sys.stderr.write(safe_lines(text, "  ") + "\n")
    sys.stderr.flush()


def print_json(value: object) -> None:
    """Print a value with a form on the wire as one line of JSON on stdout; control characters are escaped."""
    import msgspec

    from robrain.protocol.safe_text import safe_json

    sys.stdout.write(safe_json(msgspec.json.encode(value, enc_hook=str)) + "\n")
    sys.stdout.flush()


def print_either(value: object, shown: Iterable[str] | Callable[[], object], *, as_json: bool) -> None:
    """Print a value as JSON, or else the lines that say the same, or call the function that shows it."""
    if as_json:
        print_json(value)
    elif callable(shown):
        shown()
    else:
        for line in shown:
            print_result(line)
