"""``gibson-sim bench web``: the live page in a real browser: its first image, the rate and latency of its images, the cost of its server."""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.report_file import add_report_options, print_progress, write_json
from gibson_sim.errors import ConfigError
from gibson_sim_bench import timing
from gibson_sim_bench.browser import chromium
from gibson_sim_bench.cli.processes import TIMEOUT_S, BenchError, node_result, process

_SAMPLER = """(seconds) => new Promise((done) => {
  const found = [], begin = performance.now(); let last = '';
  const look = () => {
    const canvas = document.querySelector('canvas[data-stamp]'), stamp = canvas ? canvas.dataset.stamp : '';
    if (stamp !== last) { last = stamp; found.push([(performance.timeOrigin + performance.now()) / 1000, Number(stamp)]); }
    performance.now() - begin > seconds * 1000 ? done(found) : requestAnimationFrame(look);
  };
  look();
})"""
"""Samples, in each animation frame of the browser, whether the page shows a new image: wall time and stamp, seconds."""
_DRAWN = "Number(document.querySelector('#scene3d').dataset.drawn || 0)"
"""How often the page has drawn the scene in 3-D."""
_FIRST = """(() => {
  const look = () => document.querySelector('canvas[data-stamp]') ? requestAnimationFrame(() => { window.firstImage = performance.now(); })
    : requestAnimationFrame(look);
  look();
})()"""
"""Notes when the first image has been painted, milliseconds from the navigation."""
_SETTLE_S = 3.0
"""Wall time before the measurement, seconds."""


def add_parser(kinds: Any) -> None:
    """Adds the sub-command."""
    parser = kinds.add_parser(
        "web",
        help="first image, latency and rate of the live page's images in a real browser (needs Chromium and playwright)",
        description="Runs a simulation with its page, opens the page in headless Chromium, with map and 3-D in view, and drives.",
    )
    parser.add_argument("--scene", default="linden_flat", help="scene (default: linden_flat)")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="wall time to measure (default: 20)")
    add_report_options(parser)
    parser.add_argument("--domain-id", type=int, metavar="N", help="ROS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Prints the measurements, and writes the JSON file if one is named."""
    if args.seconds <= 0:
        raise ConfigError(f"--seconds {args.seconds:g}: must be above 0")
    require_nodes()
    facts = timing.facts()
    found = measure(args.scene, args.seconds, args.domain_id)
    print(
        f"{found['images']} images in {found['seconds']:.1f} s: {found['images_per_s']:.1f}/s; from tick to pixels "
        f"{found['latency_ms']['median']:.0f} ms (median), {found['latency_ms']['p95']:.0f} ms (95 %); "
        f"real-time factor {found['real_time_factor']:.2f}; first image {found['first_image_ms']:.0f} ms after the navigation; 3-D drawn "
        f"{found['drawn_3d_per_s']:.1f}/s"
    )
    shares = sorted(found["shares"].items(), key=lambda item: -item[1])
    print("shares of a core: " + ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in shares))
    write_json(args.json, {"kind": "web", "facts": asdict(facts), **found})
    return 0


def measure(scene: str, seconds: float, domain_id: int | None = None) -> dict[str, Any]:
    """Measures the live page of a running simulation in Chromium, while the page drives the robot.

    Args:
        scene: name or path.
        seconds: wall time to measure.
        domain_id: ROS domain; None = that of the environment.

    Returns:
        ``images``, ``seconds``, ``images_per_s``, ``latency_ms`` (``median``, ``p95``), ``real_time_factor``, ``first_image_ms``,
        ``drawn_3d_per_s`` and ``shares``, the processor time per second of ``physics``, ``render``, ``web`` (the page's server) and
        ``browser``. The latency is the wall time from the publication of a tick on /clock to the frame of the browser in which its
        image is on the page.

    Raises:
        EnvironmentProblemError: there is no Chromium, or no playwright.
        BenchError: the page shows nothing.
    """
    environment, port = node_environment(domain_id=domain_id), _free_port()
    command = [sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", scene, "--web-port", str(port)]
    with chromium(webgl=True) as browser, process(command, environment) as pid, ThreadPoolExecutor(1) as pool:
        page = _opened(browser, f"http://127.0.0.1:{port}/")
        clock = pool.submit(node_result, environment, "clock_arrivals", _SETTLE_S + seconds, seconds=_SETTLE_S + seconds)
        page.keyboard.down("a")
        page.wait_for_timeout(_SETTLE_S * 1000)
        print_progress(f"measuring for {seconds:g} s")
        programs = {**_nodes_of(pid), "browser": _browser_processes()}
        drawn, before, begin = page.evaluate(_DRAWN), _cpu_s(programs), time.monotonic()
        images = page.evaluate(_SAMPLER, seconds)[1:]
        lasted = time.monotonic() - begin
        drawn, after = page.evaluate(_DRAWN) - drawn, _cpu_s(programs)
        first_ms = float(page.evaluate("window.firstImage"))
        marks = clock.result()
    if len(images) < 2:
        raise BenchError(f"the page showed {len(images)} images in {seconds:g} s")
    latencies = sorted(1000.0 * (wall - stamp - marks["offset_s"]) for wall, stamp in images)
    passed = images[-1][0] - images[0][0]
    return {
        "scene": scene,
        "images": len(images),
        "seconds": passed,
        "images_per_s": (len(images) - 1) / passed,
        "latency_ms": {"median": latencies[len(latencies) // 2], "p95": latencies[int(0.95 * len(latencies))]},
        "real_time_factor": (images[-1][1] - images[0][1]) / passed,
        "first_image_ms": first_ms,
        "drawn_3d_per_s": drawn / lasted,
        "shares": {name: (after[name] - used) / lasted for name, used in before.items()},
    }


def _nodes_of(pid: int) -> dict[str, list[int]]:
    """Returns the node processes of the launcher ``pid``: name -> process id."""
    found = {}
    for child in _children(pid):
        if name := re.search(rb"nodes\.(physics|render|web)_node", Path(f"/proc/{child}/cmdline").read_bytes()):
            found[name[1].decode()] = [child]
    return found


def _browser_processes() -> list[int]:
    """Returns the ids of the processes below this one that belong to Chromium."""
    below, found = _children(os.getpid()), []
    while below:
        pid = below.pop()
        below += _children(pid)
        if Path(f"/proc/{pid}/comm").read_text(encoding="ascii").startswith("chrom"):
            found.append(pid)
    return found


def _children(pid: int) -> list[int]:
    return [
        int(child)
        for children in Path(f"/proc/{pid}/task").glob("*/children")
        for child in children.read_text(encoding="ascii").split()
    ]


def _cpu_s(programs: dict[str, list[int]]) -> dict[str, float]:
    """Returns the processor time of each program, seconds."""
    return {name: sum(map(timing.process_cpu_s, pids)) for name, pids in programs.items()}


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _opened(browser: Any, url: str) -> Any:
    """Returns the page once it shows images."""
    from playwright.sync_api import Error

    deadline = time.monotonic() + TIMEOUT_S
    while True:
        page = browser.new_page(viewport={"width": 1360, "height": 820}, bypass_csp=True)
        page.add_init_script(_FIRST)
        try:
            page.goto(url)
            page.wait_for_selector("canvas[data-stamp]", timeout=20_000)
        except Error as error:
            page.close()
            if time.monotonic() > deadline:
                raise BenchError(f"the page at {url} shows no images: {error}") from error
            time.sleep(0.5)
        else:
            return page
