"""Imports third-party scenes, checks them, and repairs faults."""
