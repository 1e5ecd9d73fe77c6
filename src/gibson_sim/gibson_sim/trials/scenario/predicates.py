"""Checks that the predicate functions named by a scenario exist, without running any of their code."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from importlib.machinery import PathFinder
from pathlib import Path

from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.settings import nearest

_MAX_BYTES = 4_000_000
"""Largest size of a module that is read, bytes."""


def predicate_problem(text: str, folders: Sequence[str]) -> str:
    """Returns why ``module:function`` cannot be called; empty = the module exists and seems to define the function.

    Args:
        text: the predicate.
        folders: search path for modules, like ``sys.path``.
    """
    module, _, function = text.partition(":")
    locations: Sequence[str] | None = folders
    spec = None
    for depth, part in enumerate(module.split("."), 1):
        # Unlike importlib.util.find_spec, this does not import parent packages.
        spec = PathFinder.find_spec(part, list(locations or ()))
        if spec is None:
            name = ".".join(module.split(".")[:depth])
            searched = f"in {folders[0]} and in Python's path" if depth == 1 else "in that package"
            return f"there is no module {quoted(name)} {searched}"
        locations = spec.submodule_search_locations
    if spec is None or not (spec.origin or "").endswith(".py"):
        return "" if spec is not None and spec.origin else f"{quoted(module)} is a folder, not a module"
    try:
        tree = ast.parse(read_file(Path(spec.origin or ""), _MAX_BYTES))
    except (OSError, SyntaxError, ValueError, RecursionError) as error:
        return f"{spec.origin} cannot be read: {error}"
    names = list(_names(tree))
    if function in names or "*" in names:
        return ""
    hint = nearest(function, names)
    return f"{spec.origin} has no {quoted(function)}{f'; {hint}' if hint else ''}"


def _names(tree: ast.Module) -> Iterator[str]:
    """Yields the names that a module binds in any scope; ``*`` if it imports all names of another module."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            yield from (alias.asname or alias.name for alias in node.names)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
