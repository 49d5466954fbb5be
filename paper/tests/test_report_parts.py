"""Parts of the report: formulas, numbers, and what its drawings say."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import paper
from paper.report import drawings
from paper.report.formulas import gap, mathml, percent, readable


@pytest.mark.parametrize(
    ("plain", "html"),
    [
        ("x0_hat and A^ xf^ <= 1", "x̂<sub>0</sub> and Â x̂<sub>f</sub> ≤ 1"),
        ("R_{k+1} = q^(n-1) - w^T", "R<sub>k+1</sub> = q<sup>n−1</sup> − w<sup>T</sup>"),
        ("sum_{k<K} ||M||_inf^2", "∑<sub>k&lt;K</sub> ‖M‖<sub>∞</sub><sup>2</sup>"),
        ("1e-9, 2.5e-12, 1.2e-01", "10<sup>−9</sup>, 2.5\u202f·\u202f10<sup>−12</sup>, 0.12"),
        ("a 4 x 4 matrix, (1, -2)", "a 4 × 4 matrix, (1, −2)"),
        ("the sum of 2-norms, `fuse`", "the sum of 2-norms, <code>fuse</code>"),
        ("<b>steps</b> & stochens_rs", "&lt;b&gt;steps&lt;/b&gt; &amp; stochens_rs"),
    ],
)
def test_plain_formulas_become_readable(plain, html):
    assert readable(plain) == html


def test_no_plain_formula_is_left_in_a_statement(claimed):
    for row in claimed[0].rows:
        for text in (row.says, row.corrected, *(one.text for one in row.evidence)):
            shown = readable(text)
            assert re.findall(r"[_^`]|\|\||&[lg]t;=|\beps\b|\de[+-]\d", shown) == [], text
            opened, closed = (re.findall(rf"<{end}(\w+)>", shown) for end in ("", "/"))
            assert set(opened) <= {"sub", "sup", "code"}
            assert sorted(opened) == sorted(closed)


def test_mathml():
    assert mathml("E d_N^2 <= V/N") == (
        "<math><mi>E</mi><msubsup><mi>d</mi><mi>N</mi><mn>2</mn></msubsup><mo>≤</mo><mi>V</mi>"
        '<mo stretchy="false" lspace="0" rspace="0">/</mo><mi>N</mi></math>'
    )
    assert mathml("x_{a < b}") == (
        "<math><msub><mi>x</mi><mrow><mi>a</mi><mo>&lt;</mo><mi>b</mi></mrow></msub></math>"
    )


def test_rounding_of_zero_is_not_a_number():
    assert gap(1.67e-16) == "0 to rounding"
    assert gap(4.9e-11) == "4.9e-11"


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1.0, "100 %"), (1e-5, "less than 0.01 %"), (0.0312, "3.1 %"), (0.28, "28 %")],
)
def test_percent(share, text):
    assert percent(share) == text


def test_what_is_seen_changes_with_the_errors():
    power = paper.power(rng=3, replicates=4, samples=60)
    panel = power.panel("1a")
    alse = panel.curve("alse")
    errors = np.full_like(alse.errors, 0.25)
    flat = dataclasses.replace(panel, curves=(dataclasses.replace(alse, errors=errors),))
    sizes = power.sizes
    assert "ALSE stays from 25 % to 25 %" in drawings.seen(flat, sizes)
    errors[:, 3:] = 0.0
    assert f"ALSE is at zero to rounding from N = {sizes[3]} on" in drawings.seen(flat, sizes)
    errors[:, -1] = 2.0
    assert "ALSE rises from 25 % to 200 %" in drawings.seen(flat, sizes)
