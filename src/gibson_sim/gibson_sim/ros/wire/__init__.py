"""Serialization of messages (CDR), message types, and a check of the transport of large messages over DDS."""
