"""Levels of detail: clusters at load time, and the choice among them for each picture."""
