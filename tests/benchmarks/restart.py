"""A render node is killed while it draws: how long until the next image arrives, by what Fast DDS takes for a dead port.

    python tests/benchmarks/restart.py --milliseconds 1000 3000 10000 --json docs/benchmarks/restart_cpu.json

``healthy_check_timeout_ms`` of ``config/fastdds.xml`` is set to each of the values in turn. Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gibson_sim.cli.report_file import write_json
from gibson_sim.reach import LOCAL, PROFILE_VARIABLE, apply_reach, profile_of
from gibson_sim_bench import timing
from support.simulation import Launched, Listener, new_context

IMAGE = "camera/image_raw"
TIMEOUT = re.compile(r"(?<=<healthy_check_timeout_ms>)\d+")


def seconds_without_images(scene: str) -> float:
    """Returns the time from a SIGKILL of the render node to the first image of the one that takes its place."""
    from sensor_msgs.msg import Image

    context = new_context()
    listener = Listener(context)
    images = listener.collect(Image, IMAGE)
    launched = Launched("run", "--scene", scene)
    try:
        listener.spin_until(lambda: len(images) > 30, "images")
        os.kill(launched.node_pid("render"), signal.SIGKILL)
        killed = time.monotonic()
        listener.spin_until(lambda: any("restarting it" in line for line in launched.lines), "a new render node")
        images.clear()
        listener.spin_until(lambda: bool(images), "an image of it")
        return time.monotonic() - killed
    finally:
        launched.stop()
        listener.close()
        context.shutdown()


def main() -> None:
    """Prints, for each value, the seconds of each repetition."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--milliseconds", nargs="+", type=int, default=[1000, 3000, 10000])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--scene", default="flat")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    apply_reach(os.environ, LOCAL)
    usual = profile_of(LOCAL).read_text(encoding="utf-8")
    assert TIMEOUT.search(usual), f"{profile_of(LOCAL)} has another form than this program knows"
    found: dict[int, list[float]] = {}
    for milliseconds in args.milliseconds:
        with TemporaryDirectory() as folder:
            profile = Path(folder) / "fastdds.xml"
            profile.write_text(TIMEOUT.sub(str(milliseconds), usual), encoding="utf-8")
            os.environ[PROFILE_VARIABLE] = str(profile)
            found[milliseconds] = [round(seconds_without_images(args.scene), 2) for _ in range(args.repeat)]
        print(f"{milliseconds} ms: {found[milliseconds]} s", flush=True)
    values = {"date": timing.now(), "version": timing.version(), "machine": timing.machine(), "cores": timing.cores()}
    write_json(args.json, {**values, "scene": args.scene, "seconds": found})


if __name__ == "__main__":
    main()
