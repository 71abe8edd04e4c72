"""The command `completion`: the script by which a shell completes commands, options and files."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_ORBITFINDER_COMPLETE"


def script(shell: str, program: str = "orbitfinder") -> str:
    """Click's completion script of a shell, for the command `orbitfinder`."""
    from click.shell_completion import get_completion_class

    from orbitfinder.cli.group import cli

    kind = get_completion_class(shell)
    if kind is None:  # the choices of the command exclude it
        raise ValueError(shell)
    return kind(cli, {}, program, VARIABLE).source()


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print the completion script for a SHELL; the shell reads it when it starts.

    \b
    Examples:
      orbitfinder completion bash >> ~/.bashrc
      orbitfinder completion zsh >> ~/.zshrc
      orbitfinder completion fish > ~/.config/fish/completions/orbitfinder.fish
    """
    click.echo(script(shell))
