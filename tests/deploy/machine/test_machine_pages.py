"""What the pages for real machines say to type is there: commands, options, units and files."""

import re
import shlex
from pathlib import Path

import pytest

from robrain.deploy.machine.machine_files import write_files
from tests.deploy.machine.test_machine_files import check_words

PAGES = Path(__file__).parents[3] / "docs" / "how-to"
MACHINES = ("robot-computer.md", "site-router.md", "operator-desk.md", "several-machines.md")
BLOCK = re.compile(r"^```(?:sh|console)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
SYSTEM_UNITS = {"chrony", "systemd-journald", "systemd-networkd"}


def typed(page: str) -> list[list[str]]:
    """Commands in a page's blocks, as words; without prompt and comment."""
    blocks = BLOCK.findall((PAGES / page).read_text(encoding="utf-8"))
    lines = [re.sub(r"^[#$] ", "", line) for block in blocks for line in block.splitlines()]
    return [words for line in lines for part in line.split("&&") if (words := shlex.split(part, comments=True))]


def inline(page: str) -> list[list[str]]:
    return [
        shlex.split(found) for found in re.findall(r"`(systemctl [^`]+)`", (PAGES / page).read_text(encoding="utf-8"))
    ]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("machine") / "files"
    write_files(folder)
    return folder


@pytest.mark.parametrize("page", MACHINES)
def test_commands_of_robrain_have_their_options(page: str) -> None:
    found = [words[1:] for words in typed(page) if words[0].rpartition("/")[2] == "robrain"]
    assert found or page == "site-router.md"
    for words in found:
        check_words([word for word in words if word != "…"])


@pytest.mark.parametrize("page", MACHINES)
def test_units_that_are_started_are_there(page: str, files: Path) -> None:
    for words in (*typed(page), *inline(page)):
        if words[0] != "systemctl" or words[1] in ("daemon-reload", "edit"):
            continue
        for unit in (word for word in words[2:] if not word.startswith("-")):
            name = re.sub(r"@[\w]+$", "@", unit)
            there = unit in SYSTEM_UNITS or any(
                (files / "systemd" / f"{name}{ending}").is_file() for ending in ("", ".service")
            )
            assert there, unit


@pytest.mark.parametrize("page", MACHINES)
def test_files_that_are_copied_are_there(page: str, files: Path) -> None:
    for words in typed(page):
        if words[0] in ("cp", "install"):
            for word in words[1:-1]:
                if word.startswith("/opt/robrain/files/"):
                    pattern = word.removeprefix("/opt/robrain/files/")
                    assert list(files.glob(pattern)), word
