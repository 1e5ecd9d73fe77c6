"""Repairs bags: reads damaged storage files to their end, and writes what can be read to new ones."""
