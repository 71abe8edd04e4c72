"""The option --compile on|off|auto of every command that integrates for long."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import click

VARIABLE = "ORBITFINDER_COMPILE"


def _remember(context: click.Context, _: click.Parameter, value: str | None) -> None:
    """Put the mode where worker processes find it too, for as long as the command runs."""
    if value is None:
        return
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = value

    def restore() -> None:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before

    context.call_on_close(restore)
    if value == "on":
        from orbitfinder.compiled import available

        found, reason = available()
        if not found:
            click.echo(f"--compile on: {reason}; running interpreted", err=True)


def compile_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option to a command; its value reaches `orbitfinder.compiled` by the environment variable."""
    option = click.option(
        "--compile", "compile_mode", type=click.Choice(("on", "off", "auto")), default=None, expose_value=False,
        callback=_remember, help="Compiled equations: always, never, or where it pays (auto, the default).",
    )  # fmt: skip
    return option(command)
