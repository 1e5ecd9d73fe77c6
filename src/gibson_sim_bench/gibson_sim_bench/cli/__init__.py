"""The sub-commands of ``gibson-sim bench``."""
