"""Status output of the launcher for a running job: once when all nodes are ready, and while it runs. Pure: reads the status files of the nodes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gibson_sim.processes.job_folder import LOADED, PAGE, READY, STATUS, read_note
from gibson_sim.quoting import enumerated

PERIOD_S = 10.0
"""Interval between two status lines without a terminal, seconds of wall time."""
_MOST_NAMES = 3
"""Maximum number of touched objects that are named per robot."""


@dataclass(frozen=True)
class Hints:
    """Content of the ready lines in addition to the status files of the nodes."""

    domain: int
    """ROS domain."""
    drive: str = ""
    """Source of commands that already drives the robots; empty = none, so the line names the options."""
    stop: str = "Ctrl-C"
    """Condition that ends the job."""
    paused: bool = False
    """Whether time starts only on request."""
    taken_port: int = 0
    """Default port of the page if another program has it, so that the page got another one; 0 = it is as usual."""


class JobStatus:
    """Reads the status files of a job's nodes.

    Args:
        folder: folder of the job.
        nodes: names of its nodes, in the order in which they load.
    """

    def __init__(self, folder: Path, nodes: Sequence[str]) -> None:
        self._folder, self._nodes = folder, nodes

    @property
    def is_ready(self) -> bool:
        """Whether time has started, or will start with the first request."""
        return (self._folder / READY).exists()

    def ready_lines(self, hints: Hints) -> list[str]:
        """Returns the lines for the user once all nodes are ready."""
        loaded = json.loads(read_note(self._folder, LOADED) or "{}")
        robots = ", ".join(f"{r['name']} ({r['model']})" for r in loaded.get("robots", ())) or "none"
        cameras = ", ".join(
            f"{c['name']} {c['width']}x{c['height']} {'+'.join(c['outputs'])} {c['rate_hz']:g} Hz"
            for c in loaded.get("cameras", ())
        )
        where = f" --domain-id {hints.domain}" if hints.domain else ""
        page = read_note(self._folder, PAGE)
        keys = f"`gibson-sim drive keyboard{where}` in a second terminal"
        drive = hints.drive or (f"W A S D on the page, {keys}" if page else keys) + ", or publish cmd_vel"
        lines = [f"ready: {loaded.get('scene', '')} in ROS domain {hints.domain}; robots: {robots}"]
        if "render" in self._nodes:
            lines.append(f"cameras: {cameras or 'none'}")
        if any(robot["drives"] for robot in loaded.get("robots", ())):
            lines.append(f"drive: {drive}")
        taken = f" (port {hints.taken_port} is taken)" if page and hints.taken_port else ""
        lines.append(f"look: {page or f'`gibson-sim web{where}` in a second terminal serves a page for your browser'}{taken}")
        if hints.paused:
            lines.append(f"time: paused; `gibson-sim play{where}` starts it")
        return [*lines, f"stop: {hints.stop}"]

    def line(self) -> str:
        """Returns the current state in one line: loading progress, or state of the simulation; empty = unknown yet."""
        statuses = {name: self._read(name) for name in ("physics", *self._nodes)}
        if not self.is_ready:
            loading = [f"{name}: {values['loading']}" for name, values in statuses.items() if values.get("loading")]
            return f"loading: {', '.join(loading)}" if loading else ""
        p, r = statuses["physics"], statuses.get("render", {})
        if "simulation_time_s" not in p:
            return ""
        parts = [f"{p['simulation_time_s']:.1f} s"]
        parts.append(f"real-time factor {p['real_time_factor']:.2f}" if p["state"] == "playing" else p["state"])
        if r.get("loading"):
            parts.append(f"render loads: {r['loading']}")
        elif r.get("images_per_s") or r.get("failed"):
            parts += [f"{r['images_per_s']:.0f} images/s", f"{r['skipped']:.0f} skipped"]
            parts += [f"{r['failed']:.0f} failed"] if r.get("failed") else []
        elif r:
            parts.append("images: no subscriber")
        if waits := p.get("waits_for"):
            parts.append(f"waits for {waits}")
        touches = [f"{robot} touches {_names(things)}" for robot, things in p.get("touches", {}).items() if things]
        return ", ".join([*parts, *touches])

    def _read(self, node: str) -> dict[str, Any]:
        text = read_note(self._folder, STATUS.format(node))
        values: dict[str, Any] = json.loads(text) if text else {}
        return values


def _names(things: Sequence[str]) -> str:
    return enumerated(things, _MOST_NAMES)
