"""The public names: this list must change with them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import stochens_rs as se

TOP = """
    Certificate Cost Counts DataStream Ensemble EnsembleTrajectory Fit Forecast Keep Key Limits
    Misfit Model ModelStream Noise Pilot Plan Regulator StepEstimate StochensError Stream Study
    System SystemEnsemble Tracking Trajectories Trajectory Uncertain Window __version__ cases
    control control_fleet design
    exceptions fuse fuse_path gain get_num_threads identify plots predict realization_controls
    reference regulate required_samples sample sample_counts set_num_threads simulate
    simulate_ensemble steer studies theory track
"""
ROOMS = {
    "certificates": "Radius",
    "controls": "Limited NextRuns PlanError Reachability SamplePlan Typical",
    "feedback": "Loop LoopCertificate Margins Rounding Tube",
    "fleet": "FleetPlan RiskBound",
    "fusion": "Alse FusedModel Path",
    "identification": "Checks Region",
    "loops": "Call Kept Reading ReadingLoop",
    "studies": "Failure Results",
    "streams": "Look Snapshot StreamRun Trace",
    "validation": "Validation",
}


def test_the_names_at_the_top() -> None:
    assert se.__all__ == sorted(TOP.split())
    assert set(se.__all__) <= set(dir(se))
    assert all(getattr(se, name) is not None for name in se.__all__)
    assert not {"Any", "importlib", "logging"} & set(dir(se))
    with pytest.raises(AttributeError, match=r"^stochens_rs has no attribute 'sampel'$"):
        se.sampel  # noqa: B018


@pytest.mark.parametrize("room", ROOMS)
def test_records_are_named_in_their_rooms(room: str) -> None:
    names = ROOMS[room].split()
    assert set(names) <= set(getattr(se, room).__all__)
    assert not set(names) & set(se.__all__)
    for name in names:
        text = f"^stochens_rs has no attribute '{name}'; it is stochens_rs.{room}.{name}$"
        with pytest.raises(AttributeError, match=text):
            getattr(se, name)


def test_what_only_the_package_uses_is_not_public() -> None:
    assert not {"Basis", "Known", "Requirement"} & set(dir(se.controls))
    assert not hasattr(se.plots, "require_matplotlib")


def test_every_exception_is_exported_and_raised_somewhere() -> None:
    package = Path(se.__file__).parent
    tree = ast.parse((package / "exceptions.py").read_text("utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    assert defined == set(se.exceptions.__all__)
    core = package.parents[1] / "rust" / "python"
    if not core.exists():
        pytest.skip("not run from a checkout")
    sources = [p.read_text("utf-8") for p in package.rglob("*.py") if p.name != "exceptions.py"]
    sources += [p.read_text("utf-8") for p in core.rglob("*.rs")]
    text = "\n".join(sources)
    unused = {
        name
        for name in defined - {"StochensError", "StateRecoveredWarning"}
        if not re.search(rf"\b{name}(\(|::new_err)", text)
    }
    assert unused == set()
