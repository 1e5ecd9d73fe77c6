"""One run of a trial: a simulation and the stack under test in a ROS domain of their own, watched, ended, and nothing left behind.

``supervisor`` starts and ends the processes; the rules by which a run ends are in ``monitor``, for the trial node
(``ros/trials/trial_node.py``), which speaks to the stack.
"""

from gibson_sim.trials.execution.node_settings import check_stack
from gibson_sim.trials.execution.supervisor import execute

__all__ = ["check_stack", "execute"]
