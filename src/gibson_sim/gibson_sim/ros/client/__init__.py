"""Clients of a running simulation: what they ask of its standard services, and a client that blocks, for tests."""
