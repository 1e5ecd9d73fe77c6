"""Brings other people's scenes into our own format, tells what is wrong with them, and mends what it can."""
