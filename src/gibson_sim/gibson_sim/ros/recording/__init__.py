"""Input and output of bags: subscriptions that receive raw messages, and a thread that writes."""
