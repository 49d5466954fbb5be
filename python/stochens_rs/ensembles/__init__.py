"""Realizations of vectors and matrices: drawn, counted, or brought by the user."""
