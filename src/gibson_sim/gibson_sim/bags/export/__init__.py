"""Data sets from bags: images, depth, poses and measurements in the formats of other programs.

``read`` finds the cameras of a bag, ``poses`` their poses; ``tum``, ``nerfstudio``, ``png`` and ``lerobot`` write. Must not import rclpy.
"""
