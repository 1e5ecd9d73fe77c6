"""The command ``gibson-sim learn``."""
