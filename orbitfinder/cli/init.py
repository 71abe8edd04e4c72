"""The command `init`: a commented problem file to start from."""

from __future__ import annotations

import click


@click.command()
@click.argument("name")
def init(name: str) -> None:
    """Write NAME.toml, a commented problem file to start from.

    \b
    Example:
      orbitfinder init my-pendulum && orbitfinder run my-pendulum.toml
    """
    from orbitfinder.problemfile.write import write_template

    path = write_template(name.removesuffix(".toml"))
    click.echo(f"{path}: written; next: orbitfinder run {path}")
