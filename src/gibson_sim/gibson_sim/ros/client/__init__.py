"""Clients of a running simulation: of its services (``simulation_client``), and of its time and topics, too, which blocks, for tests (``client``)."""
