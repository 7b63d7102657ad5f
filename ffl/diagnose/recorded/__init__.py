"""Recordings made ready: whether they are sound, how they begin, what they show by themselves and where."""
