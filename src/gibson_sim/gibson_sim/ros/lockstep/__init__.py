"""Time and repeatability: pacing, the gates that hold time for participants and images, the journal, the digests."""
