"""Files, modules and links that the documentation and the comments of the code name exist."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "gibson_sim": "src/gibson_sim",
    "gibson_sim_tools": "src/gibson_sim_tools",
    "gibson_sim_learn": "src/gibson_sim_learn",
    "gibson_sim_bench": "src/gibson_sim_bench",
    "gibson_examples": "ros_ws/src/gibson_examples",
    "gibson_path_following": "ros_ws/src/gibson_path_following",
}
"""Our Python packages: the folder that holds each."""

ENTRY_POINTS = {"gibson_sim.commands", "gibson_sim.scene_commands", "gibson_sim.tracers"}
"""Groups of entry points, which look like modules."""

FOREIGN_NAMES = {"my_node.py", "online_async_launch.py"}
"""Files of users and of other projects that the pages name."""

PATH = re.compile(r"(?<![\w/.*{}$-])(?:\.\.\./)?((?:[\w.-]+/)+[\w.-]+\.(?:py|md|msg|xml|glsl|frag|comp|vert|toml|sh|cfg))\b")
NAME = re.compile(r"(?<![\w/.*{}$-])(\w+\.(?:py|glsl|frag|comp|vert))\b")
DOTTED = re.compile(rf"(?<![\w/.-])((?:{'|'.join(PACKAGES)})(?:\.[A-Za-z]\w*)+)")
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)(?:#([^)\s]+))?\)")


def _pages() -> list[Path]:
    return [
        *sorted(ROOT.glob("*.md")),
        *sorted(ROOT.glob("docs/**/*.md")),
        *sorted(ROOT.glob("ros_ws/src/gibson_examples/**/*.md")),
        *sorted(ROOT.glob("ros_ws/src/gibson_path_following/**/*.md")),
    ]


def _code() -> list[Path]:
    source = [path for path in _tree() if path.suffix in (".py", ".glsl", ".frag", ".comp", ".vert") and path.parts[0] != "tests"]
    return [
        *source,
        Path("Makefile"),
        Path("env.sh"),
        Path("pyproject.toml"),
        Path("docker/Dockerfile"),
        Path("docker/compose.yaml"),
    ]


@cache
def _tree() -> frozenset[Path]:
    """Returns all files of the source tree, relative to its root; links to folders are not followed."""
    found: set[Path] = set()
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if not name.startswith((".", "__pycache__")) and not name.endswith(".egg-info")]
        if Path(folder) == ROOT:
            folders[:] = [name for name in folders if name in ("config", "docker", "docs", "ros_ws", "src", "tests")]
        if Path(folder) == ROOT / "ros_ws":
            folders[:] = ["src"]  # not what colcon builds beside it
        found |= {(Path(folder) / name).relative_to(ROOT) for name in names}
    return frozenset(found)


@cache
def _endings() -> frozenset[str]:
    """Returns every way to name a file by the last parts of its path: ``c.py``, ``b/c.py``, ``a/b/c.py``."""
    return frozenset("/".join(path.parts[k:]) for path in _tree() for k in range(len(path.parts)))


def _file_exists(text: str, page: Path) -> bool:
    return text in _endings() or (ROOT / text).exists() or (page.parent / text).exists()


def _name_exists(dotted: str) -> bool:
    """Returns whether a dotted name is a package, a module, or a word in the module that it leads to."""
    package, *rest = dotted.split(".")
    place = ROOT / PACKAGES[package] / package
    for k, part in enumerate(rest):
        if (place / part).is_dir():
            place = place / part
            continue
        module = place / f"{part}.py"
        source, word = (module, rest[k + 1 : k + 2]) if module.is_file() else (place / "__init__.py", rest[k : k + 1])
        text = source.read_text() if source.is_file() else ""
        return all(re.search(rf"\b{name}\b", text) for name in word)
    return True


def _missing(page: Path, bare_names: bool) -> Iterator[str]:
    for number, line in enumerate(page.read_text().splitlines(), 1):
        paths = [text for text in PATH.findall(line) if not _file_exists(text, page)]
        names = [text for text in NAME.findall(line) if bare_names and text not in _endings() | FOREIGN_NAMES]
        dotted = [text for text in DOTTED.findall(line) if text not in ENTRY_POINTS and not _name_exists(text)]
        yield from (f"{page.relative_to(ROOT)}:{number}: {text}" for text in (*paths, *names, *dotted))


def _files_of_table(head: str) -> list[str]:
    """Returns the files and folders in the first column of a table of ARCHITECTURE.md; names after a folder are in it: `a/`: `b.py`, `c.py`."""
    rows = (
        (ROOT / "ARCHITECTURE.md").read_text().split(f"| {head} | content |\n|---|---|\n", 1)[1].split("\n\n", 1)[0].splitlines()
    )
    found = []
    for row in rows:
        folder, cell = "", row.split(" | ")[0]
        for name, colon in re.findall(r"`([\w./]+)`(:?)", cell):
            if colon:
                folder = name
            elif "/" in name:
                found.append(name)
                folder = name[: name.rfind("/") + 1]
            else:
                found.append(folder + name)
    return found


@cache
def _anchors(page: Path) -> frozenset[str]:
    """Returns the anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return frozenset(
        re.sub(r"[^\w -]", "", re.sub(r"\]\([^)]*\)", "", title)).strip().lower().replace(" ", "-") for title in headings
    )


def test_files_and_modules_that_pages_name_exist() -> None:
    pages = [page for page in _pages() if page.name != "CHANGELOG.md"]  # it names files as they were
    assert [text for page in pages for text in _missing(page, bare_names=True)] == []


def test_files_and_modules_that_the_code_names_exist() -> None:
    assert [text for path in _code() for text in _missing(ROOT / path, bare_names=False)] == []


@pytest.mark.parametrize("folder", ["ros", "physics", "render"])
def test_tables_of_files_give_their_folders(folder: str) -> None:
    place = ROOT / "src/gibson_sim/gibson_sim" / folder
    named = _files_of_table(f"file in `{folder}/`")
    assert [name for name in named if not (place / name).exists()] == []


def test_table_of_ros_files_is_complete() -> None:
    place = ROOT / "src/gibson_sim/gibson_sim/ros"
    named = set(_files_of_table("file in `ros/`"))
    files = {str(path.relative_to(place)) for path in place.rglob("*.py") if path.name != "__init__.py"}
    assert sorted(name for name in files if not {name, f"{name.partition('/')[0]}/"} & named) == []


def test_links_between_pages_lead_to_a_file_and_a_heading() -> None:
    wrong = []
    for page in _pages():
        for target, anchor in LINK.findall(page.read_text()):
            file = (page.parent / target).resolve() if target else page
            if not file.exists() or (anchor and file.suffix == ".md" and anchor not in _anchors(file)):
                wrong.append(f"{page.relative_to(ROOT)}: {target}#{anchor}")
    assert wrong == []


@pytest.mark.parametrize(
    ("dotted", "there"),
    [
        ("gibson_sim.bags.recording", True),
        ("gibson_sim.bags.recording.Recording", True),
        ("gibson_sim.Simulation", True),
        ("gibson_sim.bags.not_there", False),
        ("gibson_sim.bags.recording.not_there", False),
    ],
)
def test_dotted_names_are_resolved_in_the_source_tree(dotted: str, there: bool) -> None:
    assert _name_exists(dotted) == there
