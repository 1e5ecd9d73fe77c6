"""Converts settings of nodes to command-line options, and parsed options to settings."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import Field
from typing import Any, TypeVar

from gibson_sim.cli.names import check_names
from gibson_sim.settings import Settings, make_settings, setting_fields

T = TypeVar("T", bound=Settings)


_UNITS = {"m": "METRES", "s": "SECONDS", "px": "PIXELS", "N": "NEWTONS"}
"""Unit -> full name; other units are written in capitals."""
_METAVARS = {
    "asset_roots": "DIRS",
    "cache": "DIR",
    "camera_outputs": "NAMES",
    "camera_fill": "METHOD",
    "cameras": "NAMES",
    "drive": "NAME|FILE",
    "egl_library": "FILE",
    "host": "ADDRESS",
    "lights": "FILE",
    "outputs": "NAMES",
    "participants": "RULES",
    "randomise": "NAME|FILE",
    "rate": "FACTOR",
    "register_depth": "NAMES",
    "robot": "NAME|FILE",
    "scene": "NAME|FILE",
    "start": "NAME|X,Y,DEG",
    "topics": "NAMES",
    "view_size": "WxH",
    "views": "NAMES|FILE",
}
"""Setting -> placeholder of its value in the help, if neither unit nor type describes it."""


def add_settings(parser: argparse._ActionsContainer, cls: type[Any], names: Iterable[str], *, default: str = "") -> None:
    """Adds an option for each named field of the settings class ``cls``: ``--step-hz`` for ``step_hz``.

    Args:
        parser: parser, or group of one.
        cls: settings class.
        names: names of its fields.
        default: what the help names as the default of each option, if it is not that of the class.
    """
    remaining = set(names)
    for f in setting_fields(cls):
        if f.name not in remaining:
            continue
        remaining.discard(f.name)
        text = f"{f.metadata['doc']}{f' (default: {default})' if default else _default_of(f.default)}".replace("%", "%%")
        flag = "--" + f.name.replace("_", "-")
        if isinstance(f.default, bool):
            parser.add_argument(flag, dest=f.name, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            kind = _parser_of(f.name, type(f.default))
            action = parser.add_argument(flag, dest=f.name, type=kind, default=None, metavar=_metavar(f), help=text)
            action.suggestions = f.metadata["choices"]  # type: ignore[attr-defined]  # for shell completion: the class checks them
    assert not remaining, f"{cls.__name__} has no settings {sorted(remaining)}"


def _metavar(f: Field[Any]) -> str:
    """Returns the placeholder of the value of an option in the help."""
    if f.metadata["choices"]:
        return f"{{{','.join(f.metadata['choices'])}}}"
    if f.name in _METAVARS and not isinstance(f.default, int):  # --drive of `learn filler evaluate` is a number
        return _METAVARS[f.name]
    unit: str = f.metadata["unit"]
    if unit:
        return _UNITS.get(unit, unit.upper())
    return "TEXT" if isinstance(f.default, str) else "N" if isinstance(f.default, int) else "NUMBER"


def _default_of(default: Any) -> str:
    """Returns the text about a default in the help; empty for an empty text, which the description explains, and for False."""
    if default == "" or default is False:
        return ""
    return f" (default: {'on' if default is True else f'{default:g}' if isinstance(default, float) else default})"


def _parser_of(name: str, kind: type[Any]) -> Any:
    """Returns the function that converts text to the type of the setting; a rate of ``max`` is 0, as fast as possible."""
    if name == "rate":

        def rate(text: str) -> float:
            try:
                return 0.0 if text == "max" else float(text)
            except ValueError:
                raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor max") from None

        return rate
    return kind


def given(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Returns the settings in ``names`` that were given as options."""
    return {name: getattr(args, name) for name in names if getattr(args, name, None) is not None}


def settings_from_args(cls: type[T], args: argparse.Namespace, **overrides: Any) -> T:
    """Returns ``cls`` with the given options, overridden by ``overrides``.

    Raises:
        GibsonSimError: a value is not allowed, or refers to an object that does not exist.
    """
    names = [f.name for f in setting_fields(cls)]
    config = make_settings(cls, {**given(args, names), **overrides})
    check_names(config)
    return config
