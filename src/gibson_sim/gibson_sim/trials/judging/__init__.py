"""Judges a run by its bag: verdicts, measures, a digest, and for a failed run the first thing that went wrong.

Pure: values and files go in, a ``RunResult`` comes out. Must not import rclpy. ``docs/trial_verdicts.md`` has the rules for users.
"""

from gibson_sim.trials.judging.judge import judge

__all__ = ["judge"]
