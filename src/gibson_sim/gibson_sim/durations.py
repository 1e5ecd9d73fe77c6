"""Durations as text, for progress and reports."""

from __future__ import annotations


def duration_text(seconds: float) -> str:
    """Returns a duration in a unit that suits it: ``42 s``, ``5 min`` (from 90 s on) or ``2.5 h`` (from 90 min on)."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
