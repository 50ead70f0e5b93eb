"""`make check`: compares the size of the working tree with the ceilings in `ceilings.toml`.

Lines of code are lines that are neither blank nor part of a docstring. All figures are computed from the files as they
are, or by a run of the code as it is; none is stored.
"""

import ast
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path

from tests.bench.exploration import calls
from tests.bench.task_path import path_of_a_visit
from tests.product import FOLDERS, ROOT
from tests.words import dialect_names, dialect_sentences

CEILINGS = Path(__file__).with_name("ceilings.toml")
MERGED_LINES_MAX = 600
"""A file with one importer in its folder belongs into the importer if the two stay below this number of lines."""

APART = {
    "coordinator/parts/charge_schedule.py": "it is list scheduling, which knows no coordinator",
    "coordinator/planning/remedies.py": "it changes snapshots, and knows no planner",
    "deploy/supervision/guard.py": "it is the script of a separate process",
    "plugins/device/ros2/scan_reader.py": "it needs numpy; errors are to name ROS, which is imported first",
    "recording/invariants/robot_invariants.py": "`judging.py` has the judges of robots and of tasks",
    "recording/invariants/zone_invariants.py": "likewise",
}
"""Files that are not in their importer, with the reason."""


def main() -> int:
    """Print each figure beside its ceiling; 1 if one is above it."""
    ceilings: dict[str, int] = tomllib.loads(CEILINGS.read_text())
    above = []
    for name, value in measure().items():
        if value > ceilings[name]:
            above.append(name)
        sys.stdout.write(f"{value:9,}  at most {ceilings[name]:7,}  {name}\n")
    for name in above:
        sys.stderr.write(f"{name} is above its ceiling in {CEILINGS.relative_to(ROOT)}\n")
    return int(bool(above))


def measure() -> dict[str, int]:
    """All figures that have a ceiling, by name."""
    sources = {path: path.read_text() for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    trees = {path: ast.parse(source) for path, source in sources.items()}
    packages: Counter[str] = Counter()
    for path, source in sources.items():
        packages[path.relative_to(ROOT).parts[0]] += lines_of_code(source)
    imported, loaded = imports(trees), imports(trees, at_import=True)
    visit = path_of_a_visit()
    exploring, crowded, waiting = calls()
    return {
        "product_lines": packages.total(),
        **{f"{package}_lines": packages[package] for package in FOLDERS},
        "product_files": len(sources),
        "product_folders": len({path.parent for path in sources}),
        "test_lines": sum(lines_of_code(path.read_text()) for path in (ROOT / "tests").rglob("*.py")),
        "dialect_names": sum(1 for _ in dialect_names()),
        "dialect_sentences": sum(1 for _ in dialect_sentences()),
        "class_names_defined_twice": class_names_defined_twice(trees),
        "folders_that_import_each_other": folders_that_import_each_other(imported),
        "files_that_fit_into_their_only_importer": files_that_fit_into_their_only_importer(sources, imported, loaded),
        "visit_files": len(visit),
        "visit_functions": sum(map(len, visit.values())),
        "calls_per_robot_second_of_4": exploring,
        "calls_per_robot_second_of_64": crowded,
        "calls_per_robot_second_waiting": waiting,
    }


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


def class_names_defined_twice(trees: Mapping[Path, ast.Module]) -> int:
    """Number of public names that more than one module of the product gives a class.

    Classes within classes, such as the `Parameters` of a plugin, are named with the outer one.
    """
    nodes = (node for tree in trees.values() for node in tree.body if isinstance(node, ast.ClassDef))
    names = Counter(node.name for node in nodes if not node.name.startswith("_"))
    return sum(count > 1 for count in names.values())


def imports(trees: Mapping[Path, ast.Module], *, at_import: bool = False) -> dict[Path, set[Path]]:
    """Files of the product that each file imports; with `at_import`, only those that its own import loads."""
    modules = {_module_name(path): path for path in trees}
    found: dict[Path, set[Path]] = defaultdict(set)
    for path, tree in trees.items():
        for node in tree.body if at_import else ast.walk(tree):
            match node:
                case ast.ImportFrom(module=str(module)):
                    names = [f"{module}.{alias.name}" for alias in node.names]
                    found[path].update(modules.get(name, modules.get(module, path)) for name in names)
                case ast.Import():
                    found[path].update(modules.get(alias.name, path) for alias in node.names)
        found[path].discard(path)
    return found


def folders_that_import_each_other(imported: Mapping[Path, set[Path]]) -> int:
    """Number of pairs of folders with imports in both directions."""
    folders = {(path.parent, other.parent) for path, others in imported.items() for other in others}
    return sum((b, a) in folders for a, b in folders if a < b)


def files_that_fit_into_their_only_importer(
    sources: Mapping[Path, str], imported: Mapping[Path, set[Path]], loaded: Mapping[Path, set[Path]]
) -> int:
    """Number of files with one importer, in the same folder, that stay below `MERGED_LINES_MAX` lines with it.

    Some files do not count. A file that its importer loads within a function is kept out of the start of a process. A
    file that a manifest or a table names is loaded from there as well. `APART` lists the others.
    """
    named = "".join((*sources.values(), *(path.read_text() for path in (ROOT / "plugins").rglob("*.toml"))))
    importers: dict[Path, set[Path]] = defaultdict(set)
    for path, others in imported.items():
        for other in others:
            if path.name != "__init__.py":  # which only exports
                importers[other].add(path)
    lines = {path: len(source.splitlines()) for path, source in sources.items()}
    return sum(
        importer.parent == path.parent and path in loaded[importer] and lines[path] + lines[importer] < MERGED_LINES_MAX
        for path, (importer, *more) in importers.items()
        if not more and path.name != "__init__.py" and path.relative_to(ROOT).as_posix() not in APART
        if f'"{_module_name(path)}:' not in named
    )


def _module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("robrain", *(part for part in parts if part != "__init__")))


if __name__ == "__main__":
    sys.exit(main())
