"""Imports third-party scenes into our format, checks them, and repairs what can be repaired."""
