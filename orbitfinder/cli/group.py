"""The command line: the group of all commands, and what becomes of their errors.

Heavy modules are imported inside the commands, so that --help is quick. Exit codes: 0 everything certified,
1 something did not converge or certify, 2 bad input, 130 Ctrl-C.
"""

from __future__ import annotations

import contextlib
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import click
import numpy as np

from orbitfinder._runtime import __version__, interrupt, keeping
from orbitfinder.cli.atlas import atlas
from orbitfinder.cli.continue_ import continue_
from orbitfinder.cli.diagram import diagram
from orbitfinder.cli.doctor import completion, doctor
from orbitfinder.cli.equilibria import equilibria
from orbitfinder.cli.export import animate, export, page, plot
from orbitfinder.cli.guess import guess, init
from orbitfinder.cli.map import bifurcation, map_
from orbitfinder.cli.options import (
    BAD_INPUT,
    GLUE,
    INTERRUPTED,
    JSON_KEY,
    NOT_CERTIFIED,
    limit_option,
    options_named,
    print_json,
)
from orbitfinder.cli.phase import phase, phase_plane
from orbitfinder.cli.problems import problems
from orbitfinder.cli.run import reproduce, run, simulate
from orbitfinder.cli.search import search
from orbitfinder.cli.section import connect, manifold, section
from orbitfinder.cli.show import show
from orbitfinder.cli.stabilise import stabilise
from orbitfinder.cli.studio import studio
from orbitfinder.cli.sweep import sweep
from orbitfinder.cli.torus import torus
from orbitfinder.cli.verify import prove, refine, verify
from orbitfinder.errors import InputError, OrbitfinderError

LIMITS = {
    **dict.fromkeys(("run", "simulate", "guess"), 600.0), **dict.fromkeys(("prove", "continue"), 86_400.0),
    **dict.fromkeys(("verify", "sweep", "refine", "stabilise", "torus", "section", "manifold", "connect"), 3600.0),
    **dict.fromkeys(("equilibria", "diagram", "map", "bifurcation", "phase"), 3600.0),
}  # fmt: skip
"""s after which a command stops unless --limit says otherwise: the slowest search that we ship, 100 links, takes 46,
the longest proof an hour. `search` has its budget; the others go on for as long as they are let."""


PURPOSES = {
    "Find": ("problems", "init", "guess", "run", "simulate", "sweep", "search", "atlas", "section"),
    "Follow": ("equilibria", "diagram", "continue", "bifurcation", "map", "torus", "manifold", "connect"),
    "Prove": ("verify", "prove", "refine"),
    "Use": ("stabilise", "phase", "export"),
    "Look": ("show", "studio", "plot", "phase-plane", "animate", "page", "reproduce"),
    "This program": ("doctor", "completion"),
}
"""The commands by what they are for, in the order in which they are used"""


class Commands(click.Group):
    """A group whose commands take --limit and end with a sentence and an exit code, never with a traceback."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """A command whose errors name its options, with the option --limit, which starts with what `LIMITS` says."""
        cmd.help = fitted(cmd.help or "")
        for single in cmd.commands.values() if isinstance(cmd, click.Group) else [cmd]:
            options_named(single)
            single.help = fitted(single.help or "")
        if not isinstance(cmd, click.Group):
            parts = {"run": "each search", "sweep": "the sweep", "diagram": "following"}
            cmd.params.append(limit_option(LIMITS.get(cmd.name or ""), parts.get(cmd.name or "", "")))
        super().add_command(cmd, name)

    def format_commands(self, _: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands by what they are for, each with its whole first sentence."""
        for heading, names in PURPOSES.items():
            with formatter.section(heading):
                formatter.write_dl([(name, self.commands[name].get_short_help_str(1000)) for name in names])

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """The command that is meant; a file in its place is answered with the command that takes it."""
        if args and args[0] not in self.commands and Path(args[0]).is_file():
            verb = "verify" if args[0].endswith(".json") else "run"
            meant = f"orbitfinder {verb} {args[0]}"
            raise click.UsageError(f"{args[0]!r} is a file, not a command. Did you mean: {meant}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; turn the exceptions made for people into messages."""
        with interrupt.watch(), np.errstate(all="ignore"):  # what is not finite is judged where it is used
            try:
                return super().invoke(ctx)
            except (KeyboardInterrupt, click.Abort):
                return _interrupted(ctx)
            except OrbitfinderError as error:
                if interrupt.seen:
                    return _interrupted(ctx)
                _complain(ctx, error)
                ctx.exit(BAD_INPUT if isinstance(error, InputError) else NOT_CERTIFIED)
            except Exception as error:
                if interrupt.seen:  # what CasADi makes of an interrupt
                    return _interrupted(ctx)
                if not isinstance(error, OSError):
                    raise
                # what the system does not allow; without a name it is a standard stream
                where, why = error.filename or "standard output", error.strerror or error
                remedy = "free some space or choose a place that you can read and write"
                _complain(ctx, InputError(f"{where}: {why}; {remedy}"))
                ctx.exit(BAD_INPUT)


WIDEST = 76
"""Letters of a line of help without its margin, which no terminal cuts"""


def fitted(told: str) -> str:
    """A help text whose long examples go on in the next line, as a shell takes them; no option leaves its value."""
    more: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": "    "}
    lines = []
    for line in inspect.cleandoc(told).splitlines():
        parts = [line]
        if line.startswith("  orbitfinder ") and len(line) > WIDEST:
            kept = re.sub(r"(\s--?[a-z]\S*) (?=[^-\s])", rf"\1{GLUE}", line)
            parts = textwrap.wrap(kept, WIDEST - 2, **more)
        lines.append(" \\\n".join(parts).replace(GLUE, " "))
    return "\n".join(lines)


def _interrupted(ctx: click.Context) -> None:
    what = keeping.last[-1] if keeping.last else "finished results are kept"
    click.echo(f"Interrupted: {what}, nothing half-written.", err=True)
    ctx.exit(INTERRUPTED)


def _complain(ctx: click.Context, error: OrbitfinderError) -> None:
    from orbitfinder.cli.jobs import one_line

    message = one_line(error)
    with contextlib.suppress(OSError):  # a stream that is full has been complained of
        click.echo(f"Error: {message}", err=True)
        if ctx.meta.get(JSON_KEY):
            print_json({"format": "orbitfinder/error", "error": message})


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="orbitfinder")
def cli() -> None:
    """Find periodic orbits of mechanical systems and certify them.

    \b
    Examples:
      orbitfinder init my-pendulum
      orbitfinder run my-pendulum.toml
      orbitfinder verify orbits/my-pendulum/orbit.json
    """


for command in (
    problems, run, verify, simulate, init, guess, sweep, equilibria, diagram, continue_, bifurcation, map_, section,
    manifold, connect, torus, stabilise, phase, search, atlas, prove, refine, export, show, plot, phase_plane, animate,
    page, studio, reproduce, doctor, completion,
):  # fmt: skip
    cli.add_command(command)
