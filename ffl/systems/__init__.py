"""Linear systems: zeros, poles, gain; two-sided filtering; closed loops; plant files."""
