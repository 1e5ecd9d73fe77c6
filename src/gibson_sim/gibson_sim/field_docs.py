"""Adds the field docstrings of dataclasses to ``help``: Python discards them, so they are parsed from the source.

They are parsed when ``__doc__`` is accessed, not at import. Imports no other module of the package.
"""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


class _DocWithFields:
    """``__doc__`` of a dataclass: its docstring, then the section ``Attributes`` with the docstring of each field that has one."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._full_text = ""

    def __get__(self, instance: object, owner: type) -> str:
        if not self._full_text:
            from inspect import cleandoc

            fields = field_docs(owner)
            lines = [cleandoc(self._text), *(("", "Attributes:") if fields else ())]
            self._full_text = "\n".join([*lines, *(f"    {name}: {text}" for name, text in fields.items())])
        return self._full_text


def with_field_docs(value: T) -> T:
    """Adds the field docstrings to ``help`` of a dataclass; returns the value itself, other values unchanged."""
    if isinstance(value, type) and hasattr(value, "__dataclass_fields__") and isinstance(value.__dict__.get("__doc__"), str):
        value.__doc__ = _DocWithFields(value.__dict__["__doc__"])  # type: ignore[assignment]
    return value


def field_docs(cls: type) -> dict[str, str]:
    """Returns field name -> docstring of a dataclass, those of its bases first; empty if the source is not available."""
    import ast
    import inspect
    import sys

    docs: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if not hasattr(base, "__dataclass_fields__"):
            continue
        try:
            tree = ast.parse(inspect.getsource(sys.modules[base.__module__]))
        except OSError:
            continue
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name == base.__name__:
                for pair in zip(node.body, node.body[1:], strict=False):
                    match pair:
                        case (ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text)))):
                            docs[name] = " ".join(text.split())
    return docs
