"""How much code there is: lines of the product without blank lines and docstrings, and the files that a task enters.

`python -m tests.bench.code_size` prints the lines of each folder.
"""

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from robrain.deploy.bench.figure import Bound, Figure, deterministic
from tests.bench import task_path

ROOT = Path(__file__).parents[2]
FOLDERS = ("agent", "client", "coordinator", "deploy", "plugins", "protocol", "sim")
LINES_MAX = 40_000


def measure() -> Iterator[Figure]:
    """Lines of the product, and the path of one task."""
    yield deterministic("product: lines of code", lines_by_folder().total(), "", Bound(at_most=LINES_MAX))
    yield from task_path.measure()


def lines_by_folder() -> Counter[str]:
    """Lines of code of each folder of the product."""
    lines: Counter[str] = Counter()
    for folder in FOLDERS:
        lines[folder] = sum(lines_of_code(path.read_text()) for path in (ROOT / folder).rglob("*.py"))
    return lines


def lines_of_code(source: str) -> int:
    """Lines that are neither blank nor part of a string that stands alone, such as a docstring.

    >>> lines_of_code("def one() -> int:\\n    'Return 1.'\\n\\n    return 1\\n")
    2
    """
    strings = [
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    ]
    text = {line for node in strings for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    return sum(bool(line.strip()) and number not in text for number, line in enumerate(source.splitlines(), 1))


def main() -> None:
    """Print the lines of each folder, and of all."""
    lines = lines_by_folder()
    for folder, count in lines.most_common():
        sys.stdout.write(f"{count:7,}  {folder}\n")
    sys.stdout.write(f"{lines.total():7,}  in all; bound: {LINES_MAX:,}\n")


if __name__ == "__main__":
    main()
