"""Everything that is about the paper: its experiments, its statements, a report on both."""
