"""The paper's definitions of reachability, and counterexamples to its lemmas."""
