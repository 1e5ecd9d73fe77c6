"""Trials: many runs of an unmodified ROS stack in simulation, each with a verdict. ``docs/trials.md`` is for users.

A scenario file (``scenario``) becomes a list of runs (``planning``); each is executed with a simulation and the stack in a ROS domain of its
own (``execution``), judged by its bag (``judging``), and shown (``report``). Without ROS: the node ``ros/trials/trial_node.py`` speaks to the stack.
"""
