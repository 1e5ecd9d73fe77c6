"""Networks for robots, trained in simulation: data, domains, training and export. PyTorch is needed only for training."""

__version__ = "0.1.0"
