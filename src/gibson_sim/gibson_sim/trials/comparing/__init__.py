"""Paired comparison of two trials: which runs improved or regressed, and whether the difference is significant. Maps results to sentences."""
