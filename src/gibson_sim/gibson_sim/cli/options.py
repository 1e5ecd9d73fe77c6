"""Converts settings of nodes to command-line options, and settings to arguments of node processes."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import fields
from typing import Any, TypeVar

from gibson_sim.cli.names import check_names

T = TypeVar("T")


def add_settings(parser: argparse.ArgumentParser, cls: type[Any], names: Iterable[str]) -> None:
    """Adds one option for each named field of the settings class ``cls``: ``step_hz`` becomes ``--step-hz``."""
    wanted = set(names)
    for f in fields(cls):
        if f.name not in wanted:
            continue
        wanted.discard(f.name)
        unit = f" [{f.metadata['unit']}]" if f.metadata["unit"] else ""
        text = f"{f.metadata['doc']}{unit} (default: {f.default!r})".replace("%", "%%")
        flag = "--" + f.name.replace("_", "-")
        if isinstance(f.default, bool):
            parser.add_argument(flag, dest=f.name, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            kind = _parser_of(f.name, type(f.default))
            action = parser.add_argument(flag, dest=f.name, type=kind, default=None, metavar="X", help=text)
            action.suggestions = f.metadata["choices"]  # type: ignore[attr-defined]  # for shell completion: the class checks them
    assert not wanted, f"{cls.__name__} has no settings {sorted(wanted)}"


def _parser_of(name: str, kind: type[Any]) -> Any:
    """Returns the function that converts text to the setting's type; a rate of ``max`` is 0, as fast as possible."""
    if name == "rate":

        def rate(text: str) -> float:
            try:
                return 0.0 if text == "max" else float(text)
            except ValueError:
                raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor max") from None

        return rate
    return kind


def given(args: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Returns the settings among ``names`` that were given as options."""
    return {name: getattr(args, name) for name in names if getattr(args, name, None) is not None}


def settings_from_args(cls: type[T], args: argparse.Namespace, **sure: Any) -> T:
    """Returns ``cls`` with the given options, overridden by ``sure``.

    Raises:
        GibsonSimError: a value is not allowed or names something that does not exist.
    """
    names = [f.name for f in fields(cls)]  # type: ignore[arg-type]
    config = cls(**{**given(args, names), **sure})
    check_names(config)
    return config
