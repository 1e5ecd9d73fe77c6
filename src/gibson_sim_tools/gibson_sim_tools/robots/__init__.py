"""Implements ``gibson-sim scene robot``: writes a ``robot.yaml``, measures how a robot stands and drives, and reports the results."""
