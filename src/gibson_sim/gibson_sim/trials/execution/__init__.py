"""Execution of one run: starts, monitors and ends a simulation and the stack under test in a ROS domain of their own.

``supervisor`` starts and ends the processes. ``monitor`` has the rules by which a run ends, for the trial node
(``ros/trials/trial_node.py``), which communicates with the stack.
"""

from gibson_sim.trials.execution.node_settings import check_stack
from gibson_sim.trials.execution.supervisor import execute

__all__ = ["check_stack", "execute"]
