"""Predicates: user functions, named ``module:function`` in a scenario, that judge the bag of a run.

``predicate_problem`` checks that a function exists when the scenario is loaded, without running any of its code. ``predicate_verdict`` calls
it; an exception becomes a failed verdict, never a traceback. Modules are searched in the folder of the scenario, then on ``sys.path``.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import read_file
from gibson_sim.settings import nearest
from gibson_sim.trials.records import RunSpec, Verdict

_MAX_BYTES = 4_000_000
"""Largest size of a module that is read, bytes."""
_MAX_LENGTH = 300
"""Largest length of a predicate's text, characters."""
Predicate = Callable[[Path, RunSpec], object]


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


def predicate_verdict(predicate: str, folder: Path, bag: Path, run: RunSpec) -> Verdict:
    """Returns the verdict of a predicate.

    Args:
        predicate: ``module:function``.
        folder: folder of the scenario; modules are searched there before ``sys.path``.
        bag: folder of the bag.
        run: the planned run.
    """
    name = f"predicates.{predicate}"
    try:
        with _importing_from(folder):
            returned = _function(predicate, folder)(bag, run)
    except ConfigError as error:
        return Verdict(name, False, str(error))
    # SystemExit of a predicate must not end the trial; Ctrl-C passes through.
    except (Exception, SystemExit) as error:
        return Verdict(name, False, f"{predicate} raised {_error_text(error, folder)}")
    if isinstance(returned, (bool, np.bool_)):
        return Verdict(name, bool(returned), f"{predicate} returned {bool(returned)}")
    if isinstance(returned, str):
        return Verdict(name, False, clipped(returned, _MAX_LENGTH) or f"{predicate} returned an empty text")
    return Verdict(
        name, False, f"{predicate} returned {quoted(returned)}, must be True, False, or a text with the reason why not"
    )


def _function(predicate: str, folder: Path) -> Predicate:
    """Returns a predicate's function.

    Raises:
        ConfigError: the module or function does not exist.
    """
    module_name, colon, function_name = predicate.partition(":")
    parts = module_name.split(".")
    if not colon or not function_name.isidentifier() or not all(part.isidentifier() for part in parts):
        raise ConfigError(f"predicate {quoted(predicate)} must be module:function, such as checks:stayed_upright")
    file = folder.joinpath(*parts).with_suffix(".py")
    try:
        module = _loaded(file) if file.is_file() else importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name not in {".".join(parts[: i + 1]) for i in range(len(parts))}:
            raise
        raise ConfigError(
            f"predicate {quoted(predicate)}: there is no module {module_name}; it must be {file} or lie on PYTHONPATH"
        ) from error
    function = getattr(module, function_name, None)
    if not callable(function):
        raise ConfigError(f"predicate {quoted(predicate)}: {module.__file__ or module_name} has no function {function_name}")
    return function  # type: ignore[no-any-return]


def _loaded(file: Path) -> ModuleType:
    """Returns the module in a file, loaded once per version of the file: scenarios in different folders may use the same module name."""
    version = f"{file.resolve()} {file.stat().st_mtime_ns}"
    name = f"gibson_sim_predicates_{hashlib.blake2b(version.encode(), digest_size=8).hexdigest()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Puts a folder first in ``sys.path``, so that its modules can import each other."""
    entry = str(folder.resolve())
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        if entry in sys.path:
            sys.path.remove(entry)


def _error_text(error: BaseException, folder: Path) -> str:
    """Returns an exception with file and line of the innermost frame in the scenario's folder, else of the innermost frame."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{type(error).__name__}: {clipped(str(error.msg), _MAX_LENGTH)} ({error.filename}, line {error.lineno})"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename != __file__ and not f.filename.startswith("<")]
    scenario_frames = [frame for frame in frames if Path(frame.filename).resolve().is_relative_to(folder.resolve())]
    at = next((f" ({frame.filename}, line {frame.lineno})" for frame in reversed(scenario_frames or frames)), "")
    return f"{type(error).__name__}: {clipped(str(error), _MAX_LENGTH)}{at}"
