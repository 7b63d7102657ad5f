"""Who may be missing, to first order."""
