"""Input and output of bags: subscriptions that receive serialized messages, and a thread that writes."""
