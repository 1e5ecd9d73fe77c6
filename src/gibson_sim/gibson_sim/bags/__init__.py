"""Bags: writes, repairs, reads, checks, compares and exports rosbag2 folders.

Handles CDR bytes and message definitions, but must import neither rclpy nor a message package: the subscribing nodes are in ``gibson_sim.ros``.
"""
