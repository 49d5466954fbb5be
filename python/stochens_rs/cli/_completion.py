"""``stochens completion``: what a shell needs to complete commands, options and names."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from ._command import Command
from ._options import Choice
from ._output import show

VARIABLE = "_STOCHENS_COMPLETE"  # click derives it from the name of the program


@click.command(
    cls=Command,
    short_help="Print the completion script of a shell.",
    examples=[
        'completion bash   # in ~/.bashrc: eval "$(stochens completion bash)"',
        'completion zsh    # in ~/.zshrc: eval "$(stochens completion zsh)"',
        "completion fish   # in config.fish: stochens completion fish | source",
    ],
)
@click.argument("shell", type=Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print a script that completes commands, options, choices, example systems and files.

    bash must be 4.4 or newer. The output is for a shell, so there is no --json.
    """
    root = context.find_root()
    made = get_completion_class(shell)
    assert made is not None  # one of the choices
    show(made(root.command, {}, root.info_name or "stochens", VARIABLE).source())
