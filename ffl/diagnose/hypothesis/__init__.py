"""A linear model with corrections and effects beside it, and how it is fitted."""
