"""The command `completion`: the script by which a shell completes commands, options and files."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the completion script for a SHELL; the shell reads it when it starts.

    \b
    Examples:
      orbitfinder completion bash >> ~/.bashrc
      orbitfinder completion zsh >> ~/.zshrc
      orbitfinder completion fish > ~/.config/fish/completions/orbitfinder.fish
    """
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "orbitfinder", "_ORBITFINDER_COMPLETE").source())
