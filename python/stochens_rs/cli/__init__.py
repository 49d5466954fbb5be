"""The command ``stochens``: subcommands on data, on models, on studies and on the installation."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence

import click

from .._base.files import versions
from .._base.validation import nearest
from ..exceptions import InputError, InputTypeError, StateError
from ..studies.running import interruptions
from . import _command as commands
from ._control import certify_command, control_command, export_command
from ._doctor import doctor_command, study_command
from ._identify import identify_command

__all__ = ["main"]


@click.group(
    cls=commands.Group,
    commands=[identify_command, control_command, certify_command, study_command, doctor_command],
    invoke_without_command=True,
    epilog=commands.EXIT_CODES,
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
        commands.show(context.get_help())


cli.add_command(export_command)


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
    commands.occupy_standard_descriptors()
    if sys.stdout is None:
        return _fail("standard output is closed: nowhere to write results", commands.IO)
    with interruptions() as seen:
        seen.breakable = True
        code = _code(None if argv is None else list(argv))
    commands.drop_unwritten()
    return 128 + seen.number if code == commands.INTERRUPTED and seen.number else code


def _code(args: list[str] | None) -> int:
    try:
        code = cli.main(args=args, prog_name="stochens", standalone_mode=False)
        return code if isinstance(code, int) else commands.OK
    except click.ClickException as error:
        return _fail(error.format_message(), commands.USAGE)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted", commands.INTERRUPTED)
    except SystemExit as end:  # of click: a completion, or the reader of the output has closed it
        return commands.OK if not end.code else commands.IO
    except (OSError, StateError) as error:
        return _fail(_fault(error), commands.IO)
    except (InputError, InputTypeError, MemoryError, ImportError) as error:
        return _fail(str(error), commands.USAGE)
    except Exception as error:
        return _fail(f"internal error: {type(error).__name__}: {error}", commands.INTERNAL)


def _fault(error: Exception) -> str:
    """What went wrong with which file, without the number of the error, and which one was meant."""
    text, path = str(error), getattr(error, "filename", None)
    if isinstance(error, OSError) and error.strerror and path is not None:
        text = f"{path}: {error.strerror.lower()}"
    if isinstance(error, FileNotFoundError):
        folder, name = os.path.split(str(path or ""))
        with contextlib.suppress(OSError):
            text += nearest(name, os.listdir(folder or "."))
    return text


def _fail(message: str, code: int) -> int:
    """Say why in one line on standard error."""
    commands.note(f"stochens: {' '.join(message.split())}")
    return code
