"""Find the missing physics: locate, name, model, prove."""

from ffl.diagnose.diagnosis import diagnose
from ffl.diagnose.result import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
