"""Two encoders of one motion, and what lies between them."""
