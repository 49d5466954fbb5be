"""A page on the experiments and the statements."""
