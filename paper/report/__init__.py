"""A page on the experiments and the statements."""

from .page import final_errors, write_report

__all__ = ["final_errors", "write_report"]
