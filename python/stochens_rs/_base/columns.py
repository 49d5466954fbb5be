"""Tables of text."""

from __future__ import annotations


def columns(rows: list[list[str]], room: int, keys: int = 1) -> list[str]:
    """Lines of cells in columns: the first left-aligned, the others right-aligned.

    Where `room` characters are too few there are several tables, each with the first columns,
    `keys` of them.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    tables = [list(range(keys))]
    for k, width in enumerate(widths[keys:], start=keys):
        if len(tables[-1]) > keys and sum(widths[j] + 2 for j in tables[-1]) + width > room:
            tables.append(list(range(keys)))
        tables[-1].append(k)
    lines: list[str] = []
    for table in tables:
        lines += [""] * bool(lines)
        for row in rows:
            cells = [row[0].ljust(widths[0]), *(row[k].rjust(widths[k]) for k in table[1:])]
            lines.append("  ".join(cells).rstrip())
    return lines
