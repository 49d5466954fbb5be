"""``stochens study``: what the file of a study has, as text or for other programs."""

from __future__ import annotations

from ..studies import Study
from ._command import File, command
from ._output import note, show_result


@command()
def study_command(source: File, *, out: File | None = None, as_json: bool = False) -> None:
    """Show a study; write its numbers.

    Prints the medians of a study in a file, also while it runs.

    Options:
      source STUDY  The file.
      out FILE  Write all numbers: .csv, .nc, .json.
      as_json --json  Print JSON instead of text.
    For example:
      study run.study
      study run.study --out errors.nc
    """
    results = Study.resume(source).results
    if out is not None:
        results.save(out)
        note(f"written: {out}")
    show_result(results.to_dict(), str(results), as_json)
