"""The command ``stochens``: one file per subcommand."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import click

from .._base.files import versions
from .._base.validation import nearest
from ..exceptions import InputError, InputTypeError, ResourceError, StateError
from ..studies.running import interruptions
from . import _certify, _control, _doctor, _identify, _study
from ._command import EXIT_CODES, INTERNAL, INTERRUPTED, IO, OK, USAGE, Group
from ._output import drop_unwritten, note, occupy_standard_descriptors, show

__all__ = ["main"]


@click.group(
    cls=Group,
    invoke_without_command=True,
    epilog=EXIT_CODES,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "max_content_width": 100,
        "show_default": True,
    },
)
@click.version_option(
    versions()["stochens_rs"], prog_name="stochens", message="%(prog)s %(version)s"
)
@click.pass_context
def cli(context: click.Context) -> None:
    """Control of a linear system that you know only in part.

    Results go to standard output, with --json as one JSON object; progress, names of written files
    and errors to standard error, an error as one line with an exit code.

    `stochens COMMAND --help` has examples.
    """
    if context.invoked_subcommand is None:
        show(context.get_help())


for _command in (
    _identify.identify_command,
    _control.control_command,
    _certify.certify_command,
    _study.study_command,
    _doctor.doctor_command,
):
    cli.add_command(_command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code; never raises, never prints a traceback.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default: those of the process.

    Returns
    -------
    int
        The exit code, as listed by ``stochens --help``.

    Examples
    --------
    >>> from stochens_rs.cli import main
    >>> main(["control", "no.json", "--steps", "0"])
    2
    """
    occupy_standard_descriptors()
    if sys.stdout is None:
        return _fail("standard output is closed: nowhere to write results", IO)
    with interruptions() as seen:
        seen.breakable = True
        code = _code(None if argv is None else list(argv))
    drop_unwritten()
    return 128 + seen.number if code == INTERRUPTED and seen.number else code


def _code(args: list[str] | None) -> int:
    try:
        code = cli.main(args=args, prog_name="stochens", standalone_mode=False)
        return code if isinstance(code, int) else OK
    except click.ClickException as error:
        return _fail(error.format_message(), USAGE)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted", INTERRUPTED)
    except SystemExit as end:  # of click: a completion, or the reader of the output has closed it
        return OK if not end.code else IO
    except FileNotFoundError as error:
        return _fail(f"{_said(error)}{_neighbour(error.filename)}", IO)
    except (OSError, StateError) as error:
        return _fail(_said(error), IO)
    except (InputError, InputTypeError, ResourceError, ImportError) as error:
        return _fail(str(error), USAGE)
    except Exception as error:
        return _fail(f"internal error: {type(error).__name__}: {error}", INTERNAL)


def _said(error: Exception) -> str:
    """What went wrong with which file, without the number of the error."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror.lower()}"
    return str(error)


def _neighbour(path: object) -> str:
    """Ask whether a file with a similar name was meant."""
    folder, name = os.path.split(str(path or ""))
    try:
        return nearest(name, os.listdir(folder or "."))
    except OSError:
        return ""


def _fail(message: str, code: int) -> int:
    """Say why in one line on standard error."""
    note(f"stochens: {' '.join(message.split())}")
    return code
