"""Told from sample to sample, where free runs of one machine part or noise moves it."""
