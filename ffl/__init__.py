"""ffl: feedforward learning, inverse identification and diagnosis for repeating machines."""

__version__ = "0.1.0"
