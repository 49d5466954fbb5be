"""Choices that many rooms offer, under one name each."""

from __future__ import annotations

from typing import Literal, TypeAlias

Axis: TypeAlias = Literal["columns", "rows"]
Scheme: TypeAlias = Literal["iid", "systematic"]
Fusion: TypeAlias = Literal["product", "diagonal"]
