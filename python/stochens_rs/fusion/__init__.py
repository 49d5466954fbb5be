"""Realizations fused into one estimate."""
