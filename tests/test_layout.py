"""The project is laid out as ARCHITECTURE.md says, as a tree and as a wheel."""

import ast
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from zipfile import ZipFile

import pytest

import robrain
from robrain import testing
from robrain.agent.authoring.skeleton import write_skeleton
from robrain.agent.plugin import Level
from tests.product import FOLDERS, ROOT

MAX_LINES = 660
"""A file goes into its only importer below this length."""
MAY_GROW = ("docs/reference/scenarios.md", "docs/reference/topics.md", "CHANGELOG.md")
"""As long as the tables that they are printed from."""
SETUPTOOLS_WITH_LICENSE_EXPRESSIONS = 77
ONE_MECHANISM = {
    r"\bThread\(": "protocol/workers.py",
    r"\bPopen\(|os\.fork\(": "protocol/workers.py",
    r"\bThreadPoolExecutor\(": "client/asker.py",
    r"class \w*Backoff\b": "protocol/backoff.py",
    # Others wait for a message or for the next step, catch up after a pause of the machine, or have terms as leader.
    r"while not should_stop\(\)": "agent/host/live_drive.py coordinator/live.py deploy/processes/arena_process.py "
    "deploy/processes/coordinator_process.py protocol/clock.py",
}
"""The files that may use a mechanism, by its expression."""


def _own_files(*suffixes: str) -> list[Path]:
    places = [ROOT / folder for folder in (*FOLDERS, "robrain", "tests", "docs", "examples")]
    below = [path for place in places for path in place.rglob("*") if not _passes_a_link(path)]
    return sorted(path for path in (*ROOT.iterdir(), *below) if path.suffix in suffixes and path.is_file())


def _passes_a_link(path: Path) -> bool:
    return any(parent.is_symlink() for parent in (path, *path.parents) if parent.is_relative_to(ROOT))


def _name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("folder", FOLDERS)
def test_link_resolves_to_its_folder(folder: str) -> None:
    link = ROOT / "robrain" / folder
    assert link.is_symlink()
    assert not link.readlink().is_absolute()
    assert link.resolve() == (ROOT / folder).resolve()


def test_each_folder_with_code_has_a_link() -> None:
    code = {path.parts[len(ROOT.parts)] for path in ROOT.glob("[a-z]*/__init__.py")}
    assert code - {"robrain"} == set(FOLDERS)


def test_every_folder_with_code_is_a_package() -> None:
    codes = {path.parent for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    assert [_name_of(folder) for folder in sorted(codes) if not (folder / "__init__.py").is_file()] == []


@pytest.mark.slow
def test_no_file_is_too_long() -> None:
    texts = {_name_of(path): path.read_text(encoding="utf-8") for path in _own_files(".py", ".md")}
    lengths = {name: len(text.splitlines()) for name, text in texts.items() if name not in MAY_GROW}
    assert {name: lines for name, lines in lengths.items() if lines > MAX_LINES} == {}


@pytest.mark.slow
def test_no_module_imports_itself_by_way_of_others() -> None:
    circles = {" → ".join(circle) for circle in _circles(_imports_of_modules())}
    assert circles == set()


@pytest.mark.slow
def test_each_mechanism_is_in_its_file_alone() -> None:
    texts = {_name_of(path): path.read_text() for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    used = {word: " ".join(sorted(name for name in texts if re.search(word, texts[name]))) for word in ONE_MECHANISM}
    assert used == ONE_MECHANISM


def test_import_that_is_local_or_for_types_alone_closes_a_circle() -> None:
    module = "from a import x\nif TYPE_CHECKING:\n    import b.c\ndef f():\n    from b import d\n"
    assert _imports_in(module, {"a", "b", "b.c", "b.d"}) == {"a", "b.c", "b.d"}
    assert _circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == [["b", "c", "b"]]
    assert _circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def _imports_of_modules() -> dict[str, set[str]]:
    """All modules of the package, and what each imports: also within functions, and for type checkers alone."""
    paths = {_module_name(path): path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    return {name: _imports_in(path.read_text(encoding="utf-8"), set(paths)) - {name} for name, path in paths.items()}


def _module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("robrain", *(part for part in parts if part != "__init__")))


def _imports_in(source: str, modules: set[str]) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= names if names <= modules else {node.module, *names}
    return found & modules


def _circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """Circles as the way round; where several share modules, only some of them."""
    graph, found = {name: set(imports[name]) for name in sorted(imports)}, []
    while True:
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            circle = error.args[1][::-1]  # each imports the next
            found.append(circle)
            graph[circle[0]].discard(circle[1])
        else:
            return found


@pytest.mark.slow
def test_every_document_that_is_mentioned_exists() -> None:
    missing = []
    for path in _own_files(".py", ".md", ".toml"):
        text = path.read_text(encoding="utf-8")
        for mentioned in re.findall(r"(?<![\w/.:-])docs/[\w./-]*\w", text):
            if not (ROOT / mentioned).exists():
                missing.append(f"{_name_of(path)}: {mentioned}")
    assert missing == []


@pytest.mark.slow
def test_every_link_between_documents_leads_somewhere() -> None:
    missing = []
    for path in _own_files(".md"):
        for target in re.findall(r"\]\(([^)#\s]+)", re.sub("`[^`]*`", "", path.read_text(encoding="utf-8"))):
            if "://" not in target and not (path.parent / target).exists():
                missing.append(f"{_name_of(path)}: {target}")
    assert missing == []


def test_all_is_sorted_and_what_is_exported() -> None:
    assert robrain.__all__ == sorted(robrain.__all__)
    tree = ast.parse((ROOT / "robrain" / "__init__.py").read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    homes = {alias.asname or alias.name: str(node.module) for node in imports for alias in node.names}
    homes = {name: home for name, home in homes.items() if home.startswith("robrain.") and not name.startswith("_")}
    assert robrain.__all__ == sorted(homes)
    for name, home in homes.items():
        assert getattr(robrain, name).__module__ == home


def test_testing_exports_what_it_imports() -> None:
    assert testing.__all__ == sorted(testing.__all__)
    assert {name for name in vars(testing) if not name.startswith("_")} == set(testing.__all__)


def test_every_public_name_is_listed() -> None:
    assert set(robrain.__all__) <= set(dir(robrain))


def _robrain_imports(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [str(node.module)]
        yield from (name for name in names if name.partition(".")[0] == "robrain")


PUBLIC = {"robrain", "robrain.testing"}


@pytest.mark.parametrize("path", sorted((ROOT / "examples").rglob("*.py")), ids=_name_of)
def test_examples_import_public_names_alone(path: Path) -> None:
    assert set(_robrain_imports(path.read_text(encoding="utf-8"))) <= PUBLIC


def test_skeleton_of_a_plugin_imports_public_names_alone(tmp_path: Path) -> None:
    for level in Level:
        write_skeleton("lamp", level.name.lower(), tmp_path / level.name)
    assert {name for path in tmp_path.rglob("*.py") for name in _robrain_imports(path.read_text())} == PUBLIC


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")], ids=_name_of
)
def test_pages_import_public_names_alone(page: Path) -> None:
    for source in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        assert set(_robrain_imports(source)) <= PUBLIC


def test_name_that_is_not_exported_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Arena'"):
        _ = robrain.Arena


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Names of the files in the wheel; built from a copy, so that nothing is left in the tree."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in (*FOLDERS, "robrain"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    # Without a setuptools that is new enough here, pip fetches one for the build.
    isolation = ["--no-build-isolation"] if _setuptools_here() >= SETUPTOOLS_WITH_LICENSE_EXPRESSIONS else []
    built = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", *isolation, "-w", str(folder), str(source)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=400,
    )
    assert built.returncode == 0, built.stdout
    with ZipFile(next(folder.glob("*.whl"))) as archive:
        return set(archive.namelist())


def _setuptools_here() -> int:
    try:
        return int(version("setuptools").partition(".")[0])
    except PackageNotFoundError:
        return 0


@pytest.mark.system
def test_wheel_has_every_module(wheel: set[str]) -> None:
    modules = {f"robrain/{_name_of(path)}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    assert modules
    assert modules - wheel == set()
    assert {"robrain/__init__.py", "robrain/cli.py"} <= wheel


@pytest.mark.system
def test_wheel_has_every_data_file(wheel: set[str]) -> None:
    files = {f"robrain/{_name_of(path)}" for folder in FOLDERS for path in (ROOT / folder).rglob("*.[td]*")}
    data = {name for name in files if name.endswith((".toml", ".dbc"))}
    assert "robrain/plugins/unit/driver/driver.toml" in data
    assert "robrain/protocol/can/robertino.dbc" in data
    assert "robrain/sim/scenarios/depot.toml" in data
    assert data - wheel == set()
    assert "robrain/py.typed" in wheel


@pytest.mark.system
def test_wheel_has_the_files_for_real_machines(wheel: set[str]) -> None:
    found = [path for path in (ROOT / "deploy" / "machine").rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert len(found) > 20
    assert {f"robrain/{_name_of(path)}" for path in found} - wheel == set()


@pytest.mark.system
def test_wheel_has_nothing_else(wheel: set[str]) -> None:
    outside = {name for name in wheel if not re.match(r"robrain(-[^/]+\.dist-info)?/", name)}
    assert outside == set()
    assert not any(name.startswith("robrain/tests/") for name in wheel)
