"""Controllers for other machines, and the checker of their proofs."""
