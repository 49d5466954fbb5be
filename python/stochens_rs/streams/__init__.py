"""One realization at a time: a control that gets better, its certificate, and its files."""
