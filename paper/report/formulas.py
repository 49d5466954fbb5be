"""Formulas on a page: MathML of a formula, and HTML of a text with formulas in plain characters."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from html import escape
from unicodedata import normalize

from ..common import ROUNDING

# Plain characters, escaped for HTML, and the signs they stand for.
_SIGNS = {
    r"&lt;=": "≤",
    r"&gt;=": "≥",
    r"-&gt;": "→",
    r"&lt;-": "←",
    r"\|\|": "‖",
    r"(?<=\s)\.\.(?=[\s,])": "…",
    r"(?<=\s)-(?=\s)|(?<![\w)\]}])-(?=[\d.])|(?<=\()-(?=\w)|(?<=\b[A-Za-z])-(?=\d)": "−",
    r"(?<=\d) x (?=\d)": " × ",
    r"\bsqrt\(": "√(",
    r"\beps\b": "ε",
    r"\bbeta\b": "β",
    r"\bdelta\b": "δ",
    r"\bmu\b": "μ",
}
_HAT = "\u0302"  # above the letter before it
_SCRIPT = r"\{[^{}]*\}|\([^()]*\)|[+]|-?\w+"


def _number(found: re.Match[str]) -> str:
    digits, exponent = found[1], int(found[2])
    if -4 < exponent < 4:
        return f"{float(found[0]):g}"
    power = f"10<sup>{str(exponent).replace('-', '−')}</sup>"
    return power if digits == "1" else f"{digits}\u202f·\u202f{power}"


def _script(tag: str) -> Callable[[re.Match[str]], str]:
    def written(found: re.Match[str]) -> str:
        body = found[2]
        inner = body[1:-1] if body[0] in "{(" else body
        inner = "∞" if inner == "inf" else inner.replace("-", "−")
        return f"{_LARGE.get(found[1], found[1])}<{tag}>{inner}</{tag}>"

    return written


_LARGE = {"sum": "∑", "prod": "∏"}
# The steps in order; none sees the result of one before it as something else.
_STEPS: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"\b(\d+(?:\.\d+)?)e([+-]\d+)\b", _number),
    # x0_hat, xf^, A_hat: with a hat; x0, Vf, nA, v1: with an index
    (
        r"\b([xAB])(0|f)?(?:_hat\b|\^(?![\w({+-]))",
        lambda found: normalize("NFC", found[1] + _HAT) + (found[2] or ""),
    ),
    (rf"\b([xVnF]{_HAT}?)([0fA])\b", r"\1<sub>\2</sub>"),
    (r"\b([vwP])([123])\b", r"\1<sub>\2</sub>"),
    (r"(\b[vE]|\bv<sub>\d</sub>)\*", r"\1<sup>∗</sup>"),
    (r"`([^`]*)`", r"<code>\1</code>"),
    *_SIGNS.items(),
    (r"(\b[A-Za-z]|\bsum|\bprod|[‖)])_(\{[^{}]*\}|[A-Za-z]+|\d+)", _script("sub")),
    (rf"([\w)\]}}‖|>'{_HAT}])\^({_SCRIPT})", _script("sup")),
)


def number(value: float) -> str:
    """Three significant digits."""
    return f"{value:.3g}"


def percent(share: float) -> str:
    """A share in per cent with two significant digits; a positive one is never shown as 0."""
    return "less than 0.01 %" if 0 < share < 1e-4 else f"{float(f'{100 * share:.2g}'):g} %"


def thousands(count: int) -> str:
    """A count with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u2009")


def gap(value: float) -> str:
    """A relative gap; what rounding may make of 0 is not shown as a number."""
    return "0 to rounding" if value <= ROUNDING else number(value)


def readable(text: str) -> str:
    """HTML of a text: escaped, with signs, ``<sub>`` and ``<sup>`` for what stands for them.

    Parameters
    ----------
    text : str
        Prose with formulas such as ``||x(k)||^2 <= R_{k+1}``.

    Examples
    --------
    >>> readable("||A_hat||^2 <= R_{k+1} + 2.5e-12")
    '‖Â‖<sup>2</sup> ≤ R<sub>k+1</sub> + 2.5\u202f·\u202f10<sup>−12</sup>'
    """
    html = escape(text, quote=False)
    for pattern, new in _STEPS:
        html = re.sub(pattern, new, html)
    return html


_TOKEN = re.compile(
    r"\s*(?:(?P<mn>\d+(?:[.\u2009]\d+)*)|(?P<mi>[^\W\d_]+)|(?P<mo>\|\||<=|>=|\S))", re.UNICODE
)
_CLOSE = ' stretchy="false" lspace="0" rspace="0"'  # of what stands close to its neighbours
_OPERATORS = {"||": "‖", "<=": "≤", ">=": "≥", "-": "−"}


def mathml(formula: str) -> str:
    """MathML of a formula: names, numbers and operators, ``_`` and ``^`` with ``{}`` around groups.

    Parameters
    ----------
    formula : str
        Such as ``||x - x_f||^2``; a name of several letters is written upright.

    Examples
    --------
    >>> mathml("x_f")
    '<math><msub><mi>x</mi><mi>f</mi></msub></math>'
    """
    found = list(_TOKEN.finditer(formula))
    return f"<math>{''.join(_row(iter(found)))}</math>"


def _row(tokens: Iterator[re.Match[str]]) -> list[str]:
    """The elements up to the end or a closing brace."""
    row: list[str] = []
    for token in tokens:
        if token["mo"] == "}":
            break
        if token["mo"] in ("_", "^"):
            _attach(row, "sub" if token["mo"] == "_" else "sup", _one(next(tokens), tokens))
        else:
            row.append(_one(token, tokens))
    return row


def _one(token: re.Match[str], tokens: Iterator[re.Match[str]]) -> str:
    if token["mo"] == "{":
        return f"<mrow>{''.join(_row(tokens))}</mrow>"
    kind = str(token.lastgroup)
    text = _OPERATORS.get(token[kind], token[kind])
    close = _CLOSE if kind == "mo" and text in "‖|()[]/" else ""
    return f"<{kind}{close}>{escape(text)}</{kind}>"


def _attach(row: list[str], where: str, script: str) -> None:
    """Give the last element an index or a power; both at once if it has an index already."""
    base = row.pop()
    if where == "sup" and base.startswith("<msub>"):
        row.append(f"<msubsup>{base[6:-7]}{script}</msubsup>")
    else:
        row.append(f"<m{where}>{base}{script}</m{where}>")
