"""Clients of a running simulation: of its services (``simulation_client``), and of its time and topics as well, which blocks, for tests (``client``)."""
