"""Clients of a running simulation: requests to its standard services, and a blocking client for tests."""
