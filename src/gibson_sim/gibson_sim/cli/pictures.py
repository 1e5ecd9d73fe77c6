"""A video and a contact sheet from a bag."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.bags.video import write_contact_sheet, write_video


def write_pictures(bag: Path, video: Path) -> list[Path]:
    """Writes the video and, beside it, a contact sheet with the same name and ``.png``; returns both paths."""
    sheet = video.with_suffix(".png")
    write_video(bag, video)
    write_contact_sheet(bag, sheet)
    return [video, sheet]
