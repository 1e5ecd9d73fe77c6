"""The process of a simulation for tests: runs the same nodes as ``gibson-sim run`` for the lifetime of the test's process.

``python -m gibson_sim.testing.headless_main PARENT_PID SETTINGS [BAG]``; ``SETTINGS`` is the JSON of ``SimulationSettings.to_text``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from gibson_sim.cli.environment import node_environment, require_nodes
from gibson_sim.cli.job import CAMERAS, ROBOTS, STATE_TOPIC, Job, run_job
from gibson_sim.client_config import RecordConfig
from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.testing.contained_process import end_with_parent


def plan(values: dict[str, Any], bag: str, folder: Path) -> Job:
    """Returns the job for the settings of a test.

    Args:
        values: settings of each node.
        bag: folder of the bag; empty = none.
        folder: folder of the job.
    """
    job = Job(folder)
    required = {ROBOTS: 1, **({STATE_TOPIC: 1} if "render" in values else {})}
    if bag:
        job.bag, job.keep_bag = Path(bag), True
        job.configs["record"] = RecordConfig(output=bag, summary_path=str(folder / "record.json"))
        required = {STATE_TOPIC: required.get(STATE_TOPIC, 0) + 1, ROBOTS: 2, **({CAMERAS: 1} if "render" in values else {})}
    if "render" in values:
        job.configs["render"] = RenderConfig(**{**values["render"], "summary_path": str(folder / "render.json")})
    physics = {**values["physics"], "summary_path": str(folder / "physics.json")}
    physics["wait_for"] = ",".join(f"{topic}:{count}" for topic, count in required.items())
    job.configs["physics"] = PhysicsConfig.of(**physics)
    return job


def main() -> int:
    """Runs the simulation until it is signalled to end; returns the exit code."""
    end_with_parent(int(sys.argv[1]))
    settings, bag = json.loads(sys.argv[2]), "".join(sys.argv[3:])
    try:
        require_nodes()
        code, _ = run_job(lambda folder: plan(settings["nodes"], bag, folder), node_environment())
    except GibsonSimError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    return code


if __name__ == "__main__":
    sys.exit(main())
