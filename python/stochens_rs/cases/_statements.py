"""What a MATPOWER file computes beside its tables: assignments to entries, executed in order.

Read are numbers, names of numbers, the column names of ``idx_bus``, ``idx_brch`` and ``idx_gen``,
entries of the tables, + - * / ^ and a few functions of numbers. All else is refused by its line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..exceptions import InputError

# Outputs of the functions of MATPOWER, and where their values are not 1, 2, 3, ...
_BUS = [
    "PQ", "PV", "REF", "NONE", "BUS_I", "BUS_TYPE", "PD", "QD", "GS", "BS", "BUS_AREA", "VM",
    "VA", "BASE_KV", "ZONE", "VMAX", "VMIN", "LAM_P", "LAM_Q", "MU_VMAX", "MU_VMIN",
]  # fmt: skip
_BRANCH = [
    "F_BUS", "T_BUS", "BR_R", "BR_X", "BR_B", "RATE_A", "RATE_B", "RATE_C", "TAP", "SHIFT",
    "BR_STATUS", "PF", "QF", "PT", "QT", "MU_SF", "MU_ST", "ANGMIN", "ANGMAX", "MU_ANGMIN",
    "MU_ANGMAX",
]  # fmt: skip
_GEN = [
    "GEN_BUS", "PG", "QG", "QMAX", "QMIN", "VG", "MBASE", "GEN_STATUS", "PMAX", "PMIN",
    "MU_PMAX", "MU_PMIN", "MU_QMAX", "MU_QMIN", "PC1", "PC2", "QC1MIN", "QC1MAX", "QC2MIN",
    "QC2MAX", "RAMP_AGC", "RAMP_10", "RAMP_30", "RAMP_Q", "APF",
]  # fmt: skip
COLUMNS: dict[str, dict[str, int]] = {
    "idx_bus": dict(zip(_BUS, [1, 2, 3, 4, *range(1, 18)], strict=True)),
    "idx_brch": dict(zip(_BRANCH, [*range(1, 12), *range(14, 20), 12, 13, 20, 21], strict=True)),
    "idx_gen": dict(zip(_GEN, [*range(1, 11), *range(22, 26), *range(11, 22)], strict=True)),
}
_USED = ("baseMVA", "bus", "gen", "branch", "dcline")
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sqrt": math.sqrt, "abs": abs, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "acos": math.acos, "asin": math.asin, "atan": math.atan, "exp": math.exp, "log": math.log,
}  # fmt: skip
_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z]\w*(?:\.\w+)?)|(?P<sign>\.[*/^]|[-+*/^():,\[\]]))"
)
_LITERAL = re.compile(r"(\[.*\]|\{.*\}|'[^']*'|\"[^\"]*\"|[-+\d.eE]+)", re.DOTALL)


class _Unknown(Exception):
    """A statement that is not among those that are executed."""


def execute(path: Path, tables: dict[str, Any]) -> None:
    """Change the `tables` of this file as its statements do.

    Raises
    ------
    InputError
        For a statement that is no assignment of the kinds above, with its line.
    """
    names: dict[str, float] = {"pi": math.pi}
    seen: set[str] = set()
    for line, text in statements(path.read_text(encoding="utf-8", errors="replace")):
        try:
            _execute(text, tables, names, seen)
        except (_Unknown, ArithmeticError, ValueError, IndexError) as error:
            why = f" ({error})" if str(error) else ""
            raise InputError(
                f"{path}, line {line}: {' '.join(text.split())[:60]!r} is no plain assignment to "
                f"entries of mpc{why}: run loadcase and savecase in MATPOWER and pass that file"
            ) from None


def statements(text: str) -> Iterator[tuple[int, str]]:
    """The statements with the lines they begin in; comments left out, continued lines joined."""
    text = re.sub(r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$", _blank, text, flags=re.DOTALL | re.M)
    line, began, depth, quoted, found = 1, 1, 0, False, ""
    k = 0
    while k < len(text):
        c = text[k]
        # ' after a name, number or bracket is a transpose
        if c == "'" and (quoted or not re.search(r"[\w)\].']$", found)):
            quoted = not quoted
        elif not quoted and (c == "%" or text.startswith("...", k)):
            end = text.find("\n", k)
            end = len(text) if end < 0 else end
            if c == ".":  # continued
                found, line, end = found + " ", line + 1, end + 1
            k = end
            continue
        if not quoted:
            depth += (c in "[{(") - (c in "]})")
        line += c == "\n"
        quoted = quoted and c != "\n"
        if not quoted and depth <= 0 and c in ";,\n":
            if found.strip():
                yield began, found.strip()
            found, depth = "", 0
        else:
            if not found.strip() and not c.isspace():
                began = line
            found += c
        k += 1
    if found.strip():
        yield began, found.strip()


def _blank(match: re.Match[str]) -> str:
    return "\n" * match.group().count("\n")


def _execute(text: str, tables: dict[str, Any], names: dict[str, float], seen: set[str]) -> None:
    if re.match(r"function\b|(end|return)$", text):
        return
    if text == "define_constants":
        for columns in COLUMNS.values():
            names.update(columns)
        return
    sides = [part.strip() for part in re.split(r"(?<![=~<>])=(?!=)", text, maxsplit=1)]
    if len(sides) < 2:
        raise _Unknown
    left, right = sides
    if right in COLUMNS and left[:1] + left[-1:] == "[]":
        given = left[1:-1].replace(",", " ").split()
        outputs = list(COLUMNS[right])[: len(given)]
        if any(name not in ("~", meant) for name, meant in zip(given, outputs, strict=True)):
            raise _Unknown(f"columns in the order of {right} are expected")
        names.update({name: COLUMNS[right][name] for name in given if name != "~"})
        return
    if whole := re.fullmatch(r"mpc\.(\w+)(\.\w+)*", left):
        name = whole[1]
        if name not in _USED:
            return  # costs, names, areas, ...: no part of the model
        if name in seen:
            raise _Unknown(f"mpc.{name} is assigned twice")
        seen.add(name)
        if name == "baseMVA":
            tables[name] = _number(_Reader(right, tables, names).all())
        elif not _LITERAL.fullmatch(right):
            raise _Unknown
        return
    if re.fullmatch(r"[A-Za-z]\w*", left):
        names[left] = _number(_Reader(right, tables, names).all())
        return
    reader = _Reader(left, tables, names)
    table, places = reader.place()
    reader.end()
    value = _Reader(right, tables, names).all()
    if np.ndim(value) and np.shape(value) != table[places].shape:
        raise _Unknown(f"shape {np.shape(value)} for {table[places].shape}")
    table[places] = value


def _number(value: Any) -> float:
    if np.size(value) != 1:
        raise _Unknown("one number is expected")
    return float(np.asarray(value).item())


class _Reader:
    """An expression, evaluated as it is read; numbers are scalars, entries of tables 2-d arrays."""

    def __init__(self, text: str, tables: dict[str, Any], names: dict[str, float]) -> None:
        self.tables, self.names = tables, names
        self.tokens: list[tuple[str, str]] = []  # kind and text
        at, text = 0, text.rstrip()
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise _Unknown
            self.tokens.append((str(match.lastgroup), match[match.lastgroup or 0]))
            at = match.end()
        self.at = 0

    def peek(self) -> str:
        return self.tokens[self.at][1] if self.at < len(self.tokens) else ""

    def take(self, wanted: str | None = None) -> str:
        found = self.peek()
        if not found or wanted not in (None, found):
            raise _Unknown
        self.at += 1
        return found

    def end(self) -> None:
        if self.at < len(self.tokens):
            raise _Unknown

    def all(self) -> Any:
        value = self.sum()
        self.end()
        return value

    def sum(self) -> Any:
        value = self.product()
        while self.peek() in ("+", "-"):
            sign = self.take()
            value = self.of_size(value, self.product(), "." + sign)
        return value

    def product(self) -> Any:
        value = self.power()
        while self.peek() in ("*", "/", ".*", "./"):
            sign = self.take()
            value = self.of_size(value, self.power(), sign)
        return value

    def of_size(self, a: Any, b: Any, sign: str) -> Any:
        """Of one size, or one of them a number: * and / of tables are products of matrices."""
        single = np.size(b) == 1 or (np.size(a) == 1 and sign != "/")
        if not (single or (sign[0] == "." and np.shape(a) == np.shape(b))):
            raise _Unknown(f"{np.shape(a)} {sign} {np.shape(b)}")
        kind = sign[-1]
        return a + b if kind == "+" else a - b if kind == "-" else a * b if kind == "*" else a / b

    def power(self) -> Any:
        if self.peek() in ("+", "-"):
            return -self.power() if self.take() == "-" else self.power()
        value = self.atom()
        while self.peek() in ("^", ".^"):
            sign = self.take()
            negative = self.peek() == "-" and bool(self.take())
            exponent = _number(self.atom())
            if sign == "^" and np.size(value) != 1:
                raise _Unknown("a power of a matrix")
            value = value ** (-exponent if negative else exponent)
        return value

    def atom(self) -> Any:
        kind, text = self.tokens[self.at] if self.at < len(self.tokens) else ("", "")
        if kind == "number":
            return float(self.take())
        if text == "(":
            self.take()
            value = self.sum()
            self.take(")")
            return value
        if text == "mpc.baseMVA":
            self.take()
            return float(np.asarray(self.tables["baseMVA"]).item())
        if text.startswith("mpc."):
            table, places = self.place()
            return table[places]
        if text in _FUNCTIONS and text not in self.names:
            self.take()
            self.take("(")
            value = _FUNCTIONS[text](_number(self.sum()))
            self.take(")")
            return value
        if kind == "name" and text in self.names:
            return self.names[self.take()]
        raise _Unknown(f"{text} is not known" if text else "")

    def place(self) -> tuple[Any, Any]:
        """``mpc.table(rows, columns)``: the table, and rows and columns for NumPy."""
        name = self.take()
        table = self.tables.get(name[4:]) if name[:4] == "mpc." and name[4:] in _USED[1:] else None
        if table is None:
            raise _Unknown(f"{name} is no table that is read")
        self.take("(")
        rows = self.indices(table.shape[0])
        self.take(",")
        columns = self.indices(table.shape[1])
        self.take(")")
        return table, np.ix_(rows, columns)

    def indices(self, size: int) -> list[int]:
        if self.peek() == ":":
            self.take()
            return list(range(size))
        found: list[int] = []
        if self.peek() == "[":
            self.take()
            while self.peek() != "]":
                if found and self.peek() == ",":
                    self.take()
                found += self.range(self.atom())
            self.take()
        else:
            found = self.range(self.sum())
        if not all(1 <= k <= size for k in found):
            raise _Unknown(f"a place outside 1 to {size}")
        return [k - 1 for k in found]

    def range(self, first: Any) -> list[int]:
        """A place, or ``first:last``."""
        last = first
        if self.peek() == ":":
            self.take()
            last = self.atom()
        first, last = _number(first), _number(last)
        if first != int(first) or last != int(last) or not 0 <= last - first < 1e6:
            raise _Unknown("a place that is no whole number")
        return list(range(int(first), int(last) + 1))
