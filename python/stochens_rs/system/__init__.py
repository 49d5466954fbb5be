"""The system `x(k+1) = A x(k) + B u(k)`, conversions, and discretization."""

from .system import System

__all__ = ["System"]
