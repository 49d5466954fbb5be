"""How wrong a control, a prediction or an estimate can be: one record for all of them."""

from .certificate import Certificate, Radius

__all__ = ["Certificate", "Radius"]
