"""Formulas as MathML, made at build time: browsers draw it without a script or a font of ours."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.errors import SphinxError


def mathml(formula: str, block: bool) -> str:
    """MathML of a formula in LaTeX.

    A formula that cannot be read ends the build.
    """
    text = formula.strip()
    if block and "&" in text and r"\begin" not in text:
        text = rf"\begin{{align}}{text}\end{{align}}"
    try:
        made = tex2mathml(text, as_block=block)
    except (MathError, SyntaxError) as error:
        raise SphinxError(f"the formula {formula!r} cannot be shown as MathML: {error}") from error
    made = made.replace('false">/</mo>', 'false" lspace="0" rspace="0">/</mo>')
    # As in LaTeX, only \left\| and \right\| grow with what is between them.
    return made if r"\left\|" in text else made.replace("<mo>‖</mo>", '<mo stretchy="false">‖</mo>')


def inline(writer: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def display(writer: Any, node: nodes.math_block) -> None:
    """Write a formula of its own, which scrolls where it is wider than the page."""
    ids = "".join(f'<span id="{one}"></span>' for one in node["ids"])
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    body = mathml(node.astext(), block=True)
    writer.body.append(f'{ids}<div class="formula" tabindex="0">{number}{body}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer under the name of `html_math_renderer` in conf.py."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
