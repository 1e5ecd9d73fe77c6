"""Playback of bags on their topics."""
