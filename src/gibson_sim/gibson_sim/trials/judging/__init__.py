"""Judges a run from its bag: verdicts, measures, digest, and the cause of a failure.

Maps values and files to a ``RunResult``. Must not import rclpy. Rules for users: ``docs/trial_verdicts.md``.
"""

from gibson_sim.trials.judging.judge import judge

__all__ = ["judge"]
