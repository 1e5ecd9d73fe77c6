"""What ``gibson-sim scene robot --new`` does: writes a ``robot.yaml``, measures how a robot stands and drives, and reports it."""
