"""Recordings of machines: what they are, how they are read, whether they can be trusted."""

from ffl.recordings.check import check_recording
from ffl.recordings.finding import Finding
from ffl.recordings.mapping import Mapping, load_mapping
from ffl.recordings.read import read_recording, read_recordings
from ffl.recordings.readers import READERS
from ffl.recordings.recording import COLUMNS, Recording, shared_clock
from ffl.recordings.resample import resample_recording
from ffl.recordings.soundness import Soundness, soundness
from ffl.recordings.write import write_recording

__all__ = [
    "COLUMNS",
    "READERS",
    "Finding",
    "Mapping",
    "Recording",
    "Soundness",
    "check_recording",
    "load_mapping",
    "read_recording",
    "read_recordings",
    "resample_recording",
    "shared_clock",
    "soundness",
    "write_recording",
]
