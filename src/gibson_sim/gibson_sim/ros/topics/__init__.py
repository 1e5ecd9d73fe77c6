"""Topics of the nodes: names, quality of service, subscriptions and publishers of robots, arms, cameras and the world."""
