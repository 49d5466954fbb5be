"""The command ``stochens``: one file per subcommand.

Exit codes: 0 done, 1 internal error, 2 usage or input, 3 a verdict is contradicted (`claims`),
5 reading or writing files, 130 interrupted, 143 terminated.
Results go to stdout, everything else (progress, the files written, errors) to stderr.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import click

from .._base.files import versions
from ..exceptions import InputError, InputTypeError, ResourceError, StateError
from . import _claims, _info, _plan, _reproduce, _stream
from ._output import note, occupy_standard_descriptors, show

__all__ = ["main"]

OK, INTERNAL, USAGE, IO, INTERRUPTED = 0, 1, 2, 5, 130


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(
    versions()["stochens_rs"], prog_name="stochens", message="%(prog)s %(version)s"
)
@click.pass_context
def cli(context: click.Context) -> None:
    """Control of a linear system that is known only through random realizations."""
    if context.invoked_subcommand is None:
        show(context.get_help())


for _command in (_reproduce.reproduce, _claims.claims, _plan.plan, _stream.stream, _info.info):
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
        0, 1, 2, 3, 5 or 130 (see the top of this file).

    Examples
    --------
    >>> from stochens_rs.cli import main
    >>> main(["reproduce", "--samples", "0"])
    2
    """
    occupy_standard_descriptors()
    if sys.stdout is None:
        return _fail("standard output is closed: nowhere to write results", IO)
    try:
        args = None if argv is None else list(argv)
        code = cli.main(args=args, prog_name="stochens", standalone_mode=False)
        return code if isinstance(code, int) else OK
    except click.ClickException as error:
        return _fail(error.format_message(), USAGE)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted", INTERRUPTED)
    except SystemExit:  # click leaves so when whoever read the output has gone
        return IO
    except (OSError, StateError) as error:
        return _fail(str(error), IO)
    except (InputError, InputTypeError, ResourceError, ImportError) as error:
        return _fail(str(error), USAGE)
    except Exception as error:
        return _fail(f"internal error: {type(error).__name__}: {error}", INTERNAL)


def _fail(message: str, code: int) -> int:
    """One line on stderr."""
    note(f"stochens: {' '.join(message.split())}")
    return code
