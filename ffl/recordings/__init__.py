"""Recordings of machines: what they are, how they are read, whether they can be trusted."""

from ffl.recordings.check import check_recording
from ffl.recordings.mapping import Mapping, load_mapping
from ffl.recordings.read import read_recording, read_recordings
from ffl.recordings.readers import READERS
from ffl.recordings.recording import COLUMNS, Recording, shared_clock
from ffl.recordings.write import write_recording

__all__ = [
    "COLUMNS",
    "READERS",
    "Mapping",
    "Recording",
    "check_recording",
    "load_mapping",
    "read_recording",
    "read_recordings",
    "shared_clock",
    "write_recording",
]
