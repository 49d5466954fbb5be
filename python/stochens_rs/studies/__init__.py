"""Repeated runs: their errors, curves and figures."""
