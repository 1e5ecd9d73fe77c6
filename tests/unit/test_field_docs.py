"""``help`` of public dataclasses shows what their fields mean."""

from __future__ import annotations

import pydoc
from dataclasses import dataclass

import pytest

import gibson_sim as gs
from gibson_sim.field_docs import field_docs, with_field_docs


@dataclass(frozen=True)
class Base:
    """A base."""

    width: int = 1
    """Pixels,
    of one row."""
    plain: int = 2


@dataclass(frozen=True)
class Derived(Base):
    """Derived.

    Two paragraphs.
    """

    height: int = 3
    """Rows."""


def test_docstrings_of_fields_are_those_of_the_source_with_those_of_bases_first() -> None:
    assert field_docs(Derived) == {"width": "Pixels, of one row.", "height": "Rows."}
    assert with_field_docs(Derived).__doc__ == (
        "Derived.\n\nTwo paragraphs.\n\nAttributes:\n    width: Pixels, of one row.\n    height: Rows."
    )
    assert Derived().__doc__ == Derived.__doc__
    assert Base.__doc__ == "A base.", "of the class that was given alone"


def test_classes_other_than_dataclasses_are_unchanged() -> None:
    assert with_field_docs(len) is len
    assert with_field_docs(gs.Simulation).__doc__ == gs.Simulation.__doc__


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("LightSpec", "sun_color: Colour of the sunlight, sRGB, 0 to 1."),
        ("CameraSpec", "fov_y: Vertical field of view of a pinhole camera without ``matrix``, radians, in (0, pi)."),
        ("RobotSpec", "name: "),
    ],
)
def test_help_explains_the_fields_of_public_values(name: str, line: str) -> None:
    text = pydoc.plain(pydoc.render_doc(getattr(gs, name)))
    assert "Attributes:" in text and f"     {line}" in text
