"""``stochens export``: a controller in C, its proof, and the checker."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from .._base.files import write_text
from ..exceptions import StateError
from ..export import check_proof
from ..feedback import Loop
from ..identification.model import Model
from ..loops import ReadingLoop, Regulator
from ._command import File, command
from ._control import feedback_for
from ._output import note, show_result


@command()
def export_command(
    source: File,
    *,
    out: str = "controller.h",
    name: str = "controller",
    Q: str = "1",
    R: str = "1",
    proof: str | None = None,
    checker: str | None = None,
    as_json: bool = False,
) -> None:
    """Write a controller in C.

    Writes a loop as one C99 header without malloc; that of a model is the feedback u = K x of
    least cost. A proof can be checked without this package.

    Options:
      source FILE  A loop.save(path), or a model of `identify --out`.
      out --out FILE  The header.
      name NAME  What its names begin with.
      Q --Q W  For a model, the weight of the states or outputs.
      R --R W  For a model, the weight of the inputs, one or each.
      proof FILE.json  Write the proof of a feedback, too.
      checker FILE.py  Write the checker of proofs, one file that needs Python alone.
      as_json --json  Print JSON instead of text.
    For example:
      export model.safetensors --Q 1,10,0.1,1 --R 0.01 --out controller.h
      export loop.safetensors --out loop.h --name cart
      export model.safetensors --proof proof.json --checker check_proof.py
    """
    loop: Any = None
    for kind in (Loop, Regulator, ReadingLoop):
        with suppress(StateError):  # a file of another kind
            loop = loop or kind.load(source)
    loop = loop or feedback_for(Model.load(source), Q, R)
    loop.to_c(out, name=name)
    if proof is not None:
        loop.certificate().save(proof)
    if checker is not None:
        write_text(checker, Path(check_proof.__file__).read_text("utf-8"))
    facts = {"header": out, "proof": proof, "checker": checker, "loop": repr(loop)}
    for path in filter(None, (out, proof, checker)):
        note(f"written: {path}")
    show_result(facts, repr(loop), as_json)
