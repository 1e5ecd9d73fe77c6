"""Field docstrings of dataclasses in ``help``: Python drops them when it compiles a class, so they are read from the source.

They are read when ``__doc__`` is accessed, so that importing costs nothing. Imports no other part of the package.
"""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


class _DocWithFields:
    """``__doc__`` of a dataclass: its docstring, then the section ``Attributes`` with the docstring of each field that has one."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._whole = ""

    def __get__(self, instance: object, owner: type) -> str:
        if not self._whole:
            from inspect import cleandoc

            fields = field_docs(owner)
            lines = [cleandoc(self._text), *(("", "Attributes:") if fields else ())]
            self._whole = "\n".join([*lines, *(f"    {name}: {text}" for name, text in fields.items())])
        return self._whole


def with_field_docs(value: T) -> T:
    """Returns the value itself; ``help`` of a dataclass explains its fields from then on."""
    if isinstance(value, type) and hasattr(value, "__dataclass_fields__") and isinstance(value.__dict__.get("__doc__"), str):
        value.__doc__ = _DocWithFields(value.__dict__["__doc__"])  # type: ignore[assignment]
    return value


def field_docs(cls: type) -> dict[str, str]:
    """Returns the docstring of each field of a dataclass that has one, by name, those of its bases first; none without the source."""
    import ast
    import inspect
    import sys

    found: dict[str, str] = {}
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
                            found[name] = " ".join(text.split())
    return found
