"""Processes of nodes: their environment, how they start and end, the folder and the ROS domain that they share, and what ended ones leave."""
