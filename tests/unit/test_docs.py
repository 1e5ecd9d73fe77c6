"""Commands and Python code in the documentation work as shown."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from pathlib import Path

import pytest

from gibson_sim.cli import command_line
from gibson_sim.cli.main import main
from gibson_sim.scenes.load_views import load_camera_file

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
INCOMPLETE = ("the following arguments are required", "expected one argument", "invalid int value: 'N'", "'FORMAT' is unknown")
"""Errors of commands that a sentence only mentions."""
RUNNABLE = ("maps", "scenes", "manipulation")


def _blocks(page: Path, *languages: str) -> list[str]:
    return [
        block
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
        if language in languages
    ]


def _commands(page: Path) -> list[tuple[str, bool]]:
    """Returns the words behind ``gibson-sim``, and whether they are a whole command line."""
    lines = "\n".join(_blocks(page, "", "bash", "console")).replace("\\\n", " ").splitlines()
    found = [(match[1], True) for line in lines if (match := re.match(r"\s*\$?\s*gibson-sim (.*)", line))]
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    spans = [" ".join(span.split()) for span in re.findall(r"`gibson-sim ([^`]+)`", text)]
    return found + [(span, False) for span in spans if not re.search(r"\.\.\.|\\\||\[", span)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_has_the_options_that_exist(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused = []
    for command, whole in _commands(page):
        words = [word for word in shlex.split(command, comments=True) if word not in ("...", "&")]
        words = words[: next((k for k, word in enumerate(words) if word in ("&&", "|", ">", ";")), len(words))]
        try:
            command_line._parser(words).parse_args(words)
        except SystemExit as end:
            error = capsys.readouterr().err
            if end.code and (whole or not any(text in error for text in INCOMPLETE)):
                refused.append(f"gibson-sim {command}: {error}")
    assert refused == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_imports_in_docs_exist(page: Path) -> None:
    for block in _blocks(page, "python"):
        for node in ast.walk(ast.parse(block)):
            if (
                not isinstance(node, ast.ImportFrom)
                or not (node.module or "").startswith("gibson_sim")
                or ".ros" in (node.module or "")
            ):
                continue
            module = importlib.import_module(node.module or "")
            assert [alias.name for alias in node.names if not hasattr(module, alias.name)] == [], node.module


@pytest.mark.parametrize("page", RUNNABLE)
def test_python_examples_in_docs_run(page: str) -> None:
    for block in _blocks(ROOT / "docs" / f"{page}.md", "python"):
        exec(compile(block, f"docs/{page}.md", "exec"), {})


def test_cameras_of_the_data_set_page_can_be_loaded(tmp_path: Path) -> None:
    (block,) = _blocks(ROOT / "docs" / "datasets.md", "yaml")
    (tmp_path / "cameras.yaml").write_text(block)
    cameras, _ = load_camera_file(tmp_path / "cameras.yaml", ["robot/base_link"])
    assert [(camera.name, camera.link) for camera in cameras] == [("ceiling", ""), ("chest", "robot/base_link")]


def test_parameters_of_one_node_are_listed_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["params", "task"])
    assert end.value.code == 0
    assert [line for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")] == ["task"]
