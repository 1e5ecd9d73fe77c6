"""Calls predicates: functions of the user that judge a bag. Whatever they raise is a failed verdict, never a traceback."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.trials.records import RunSpec, Verdict

_LONGEST = 300
"""Longest text of a predicate, characters."""
Predicate = Callable[[Path, RunSpec], object]


def judged_by(predicate: str, folder: Path, bag: Path, run: RunSpec) -> Verdict:
    """Returns the verdict of a predicate.

    Args:
        predicate: ``module:function``.
        folder: of the scenario, where modules are looked for before ``sys.path``.
        bag: folder of the bag.
        run: the run.
    """
    name = f"predicates.{predicate}"
    try:
        with _importing_from(folder):
            answer = _function(predicate, folder)(bag, run)
    except ConfigError as error:
        return Verdict(name, False, str(error))
    # SystemExit is a predicate's own end, not that of the trial; Ctrl-C passes through.
    except (Exception, SystemExit) as error:
        return Verdict(name, False, f"{predicate} raised {_raised(error, folder)}")
    if isinstance(answer, (bool, np.bool_)):
        return Verdict(name, bool(answer), f"{predicate} returned {bool(answer)}")
    if isinstance(answer, str):
        return Verdict(name, False, clipped(answer, _LONGEST) or f"{predicate} returned an empty text")
    return Verdict(name, False, f"{predicate} returned {quoted(answer)}, must be True, False, or a text that says why not")


def _function(predicate: str, folder: Path) -> Predicate:
    """Returns a predicate's function.

    Raises:
        ConfigError: there is no such module or function.
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
    """Returns the module in a file, once for each file and state of it: scenarios in different folders may use one name."""
    state = f"{file.resolve()} {file.stat().st_mtime_ns}"
    name = f"gibson_sim_predicates_{hashlib.blake2b(state.encode(), digest_size=8).hexdigest()}"
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
    """Lets modules of a folder import each other."""
    entry = str(folder.resolve())
    sys.path.insert(0, entry)
    try:
        yield
    finally:
        if entry in sys.path:
            sys.path.remove(entry)


def _raised(error: BaseException, folder: Path) -> str:
    """Returns an exception with file and line: of the innermost frame in the scenario's folder, else of the innermost one."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{type(error).__name__}: {clipped(str(error.msg), _LONGEST)} ({error.filename}, line {error.lineno})"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename != __file__ and not f.filename.startswith("<")]
    own = [frame for frame in frames if Path(frame.filename).resolve().is_relative_to(folder.resolve())]
    at = next((f" ({frame.filename}, line {frame.lineno})" for frame in reversed(own or frames)), "")
    return f"{type(error).__name__}: {clipped(str(error), _LONGEST)}{at}"
