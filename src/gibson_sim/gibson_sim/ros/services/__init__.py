"""Services and actions of ``simulation_interfaces``, and services with deferred responses."""
