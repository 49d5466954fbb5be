"""Controls from estimates, and what is known about their errors."""
