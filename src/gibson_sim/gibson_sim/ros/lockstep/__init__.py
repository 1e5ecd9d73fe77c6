"""Time and repeatability: the pace, the gates that hold time for participants and images, the journal, the digests."""
