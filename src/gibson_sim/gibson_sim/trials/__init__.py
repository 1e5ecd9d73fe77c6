"""Trials: repeated runs of an unmodified ROS stack in simulation, each with a verdict. User documentation: ``docs/trials.md``.

A scenario file (``scenario``) becomes a list of runs (``planning``); each is executed with a simulation and the stack in a ROS domain of its
own (``execution``), judged from its bag (``judging``), and reported (``report``). No module here imports ROS; the node
``ros/trials/trial_node.py`` communicates with the stack.
"""
