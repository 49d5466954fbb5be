"""The HTML of records in notebooks: well-formed, escaped, with the main numbers."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from stochens_rs._base import show as html
from test_records import PARTS, PLANS

SYSTEM = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]], dt=0.1, name="a & <b>")
X0, XF = [1.0, 2.0], [0.0, 0.0]


def stream():
    made = se.Stream(SYSTEM, X0, XF, rng=1)
    made.step(1000)
    return made


def data_stream():
    made = se.DataStream(SYSTEM.B, ranges={"x0": 0.2, "xf": 0.0, "A": 0.0})
    made.update(x0=[X0, [1.1, 2.0]], xf=XF, A=SYSTEM.A)
    return made


def model(**options):
    draws = np.random.default_rng(1).standard_normal((20, 5))
    data = se.Trajectories.from_pairs(draws[:, :2], draws[:, 2:3], draws[:, 3:], dt=0.1)
    return se.identify(data, **opts(design="independent", **options))


def plan(**options):
    return se.steer(SYSTEM, X0, XF, 12345, rng=1, **options)


# What is no record of a file, a name that must be escaped, and words that a person looks for.
MORE = {
    "System": (lambda: SYSTEM, ["states n", "0.1 s", "a & <b>"]),
    "Certificate": (
        lambda: plan().bound(),
        ["of where the exact control leads (simulated)", "of xf", "95 %", "drawn from"],
    ),
    "Plan": (plan, ["largest |u|", "12 345 realizations", "control u(0)"]),
    "Checks": (lambda: model().checks, ["heteroscedasticity", "tails"]),
    "Stream": (stream, ["1 000", "of A", "error of the state", "certificate"]),
    "Trace": (lambda: stream().trace, []),
    "DataStream": (data_stream, ["2 of x0", "control u"]),
    "Certificate of means": (
        lambda: data_stream().confidence(),
        ["state", "guaranteed", "95 %", "the mean of the law of x0"],
    ),
    "SamplePlan": (
        lambda: se.required_samples(SYSTEM, X0, X0, 0.3, rng=1),
        ["with probability", "0.95", "exact rms", "failures", "of 1000"],
    ),
}
SHOWN = {name: (make, []) for name, make in (PLANS | PARTS).items() if name != "key"} | MORE


@pytest.mark.parametrize("name", SHOWN)
def test_a_notebook_shows_the_record(name):
    make, words = SHOWN[name]
    made = make()
    page = made._repr_html_()
    assert page == made._repr_html_()
    tree = ElementTree.fromstring(page)
    text = re.sub(r"\s", " ", "".join(tree.itertext()))
    assert tree.find(".//b").text == type(made).__name__
    assert "{" not in text
    for word in words:
        assert word in text
    assert len(page) < 12_000
    assert not re.search(r"<script|<style|<b>b|\son\w+=|https?:|nan|color:|background", page)


def test_a_bound_says_what_it_covers_in_short():
    bound = plan().bound()
    assert str(bound) == repr(bound)
    assert re.fullmatch(
        r"<Certificate: target within [\d.]+ of xf \(simulated\), mostly estimates, "
        r"95 % guaranteed>",
        repr(bound),
    )
    assert "drawn from" in bound.assumption
    assert bound.holds.startswith(
        "guaranteed with probability 95 % at least; control and state each"
    )
    exact = se.control(SYSTEM, X0, XF).bound()
    assert repr(exact).endswith(", if what was given is exact>")
    assert exact.holds == "if what was given is exact; nothing was drawn"
    fit = se.fuse(se.sample(SYSTEM.A, 9, rng=1), "slse", target=SYSTEM.A)
    assert "targets of the fits" in se.control((fit, SYSTEM.B), X0, XF).bound().assumption


@pytest.mark.parametrize(
    ("value", "bound", "text"),
    [
        (1.05961, 0.0113, "1.060 ± 0.012"), (1.00028, 0.00209, "1.0003 ± 0.0022"),
        (-3.0, 0.0, "-3 ± 0"), (2.0, np.inf, "2 ± inf"), (1e300, 1e299, "1e+300 ± 1e+299"),
        (-0.00001, 0.0015, "0.0000 ± 0.0016"), (1.0002, 0.00199, "1.0002 ± 0.0020"),
        (1234.5, 250.0, "1234 ± 2.6e+02"), (1e-300, 1e-301, "1e-300 ± 1e-301"),
    ],
)  # fmt: skip
def test_what_is_shown_as_within_contains_what_is_known(value, bound, text):
    assert html.within(value, bound) == text
    centre, radius = map(float, text.split(" ± "))
    assert centre - radius <= value - bound
    assert value + bound <= centre + radius
