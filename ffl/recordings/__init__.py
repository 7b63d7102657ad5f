"""Recordings of machines: what they are, how they are read, whether they can be trusted."""

from ffl.recordings.recording import COLUMNS, Recording, shared_clock

__all__ = ["COLUMNS", "Recording", "shared_clock"]
