"""Levels of detail: clusters built at load time, and their selection for each picture."""
