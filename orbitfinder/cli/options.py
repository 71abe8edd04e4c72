"""What the commands share: arguments that are files, options, text or JSON as output, the exit code."""

from __future__ import annotations

import functools
import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from orbitfinder._runtime.limit import limited
from orbitfinder._runtime.processes import children_see
from orbitfinder.errors import InputError, OrbitfinderError
from orbitfinder.records.codec import plain
from orbitfinder.records.reading import Entries, finite

FILES = click.Path(path_type=Path)
NOT_CERTIFIED, BAD_INPUT, INTERRUPTED = 1, 2, 130
"""Exit codes beside 0; the first also means not converged, not proved, not usable"""


class Finite(click.types.FloatParamType):
    """A number, neither infinite nor NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number, or a usage error."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


def numbers(text: str, where: str) -> tuple[float, ...]:
    """Values of a comma-separated list; `InputError` names what is no number."""
    values = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        try:
            values.append(float(word))
        except ValueError as error:
            raise InputError(f"{where}: {word!r} is not a number; give values separated by commas") from error
        if not math.isfinite(values[-1]):
            raise InputError(f"{where}: {word!r} is not finite; give finite values")
    return tuple(values)


class Numbers(click.types.StringParamType):
    """Numbers between commas."""

    def convert(self, value: Any, param: click.Parameter | None, _: click.Context | None) -> Any:
        """The numbers. Raises `InputError`."""
        return numbers(value, param.opts[-1] if param else "") if isinstance(value, str) else value


FINITE, NUMBERS = Finite(), Numbers()
JSON_KEY = "orbitfinder.json"
"""Where the context keeps whether --json was given: an error is then printed as JSON too"""
TRUST = "Execute Python problem files; only for files you have read."
SYSTEM_TRUST = "Import the Python module that a system was made with; only if you have read it."

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
orbit_files: Decorator = click.argument("files", nargs=-1, required=True, type=FILES, metavar="ORBIT.json|FILE#K...")


def options_named(command: click.Command) -> None:
    """Let a command's errors name the option that was given, where they name the argument that it became."""
    run = command.callback
    assert run is not None

    @functools.wraps(run)
    def answered(*arguments: Any, **named: Any) -> Any:
        try:
            return run(*arguments, **named)
        except InputError as error:
            source, field = click.get_current_context().get_parameter_source(error.field), error.field
            if source is not ParameterSource.COMMANDLINE:
                raise
            option = next(max(param.opts, key=len) for param in command.params if param.name == field)
            raise type(error)(option + str(error).removeprefix(field)) from error

    command.callback = answered


def _remember_json(context: click.Context, _: click.Parameter, value: bool) -> None:
    context.meta[JSON_KEY] = value


json_option: Decorator = click.option(
    "--json", is_flag=True, callback=_remember_json, is_eager=True, expose_value=False,
    help="Print one JSON document on standard output instead of text.",
)  # fmt: skip


def wants_json() -> bool:
    """Whether --json was given."""
    return bool(click.get_current_context().meta.get(JSON_KEY))


LEAST_WIDTH, LEAST_NOTE = 40, 20
GLUE = "\0"
"""Stands for a space at which no line is broken"""


def text(line: str) -> None:
    """A line of the answer for people, on a terminal in its width and in colour; nothing where --json was given."""
    if wants_json():
        return
    if not on_terminal():
        click.echo(line)
        return
    for part in folded(line, max(LEAST_WIDTH, shutil.get_terminal_size().columns)):
        click.echo(part if "NO_COLOR" in os.environ else coloured(part))


def next_step(*words: object) -> None:
    """What to type next, for who sits at a terminal."""
    if on_terminal() and not wants_json():
        text(f"next: orbitfinder {' '.join(map(str, words))}")


def on_terminal() -> bool:
    """Whether the answer is read on a terminal."""
    return sys.stdout.isatty() and os.environ.get("TERM") != "dumb"


def folded(line: str, width: int) -> list[str]:
    """A line in parts that fit, broken after commas where that suffices and never in a word.

    The parts hang below the last column of a row, where it has some.
    """
    columns = [gap.end() for gap in re.finditer(r"\S {2,}(?=\S)", line)]
    margin = len(line) - len(line.lstrip()) + 2
    hang = columns[-1] if columns and columns[-1] <= width - LEAST_NOTE else margin
    more: Entries = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": " " * hang}
    if max(map(len, line[hang:].split(", "))) <= width - hang:
        line = line[:hang] + re.sub(r"(?<=[^\s,]) (?=\S)", GLUE, line[hang:])
    return [part.replace(GLUE, " ") for part in textwrap.wrap(line, width, **more)] or [""]


def coloured(line: str) -> str:
    """The verdict in a line in green or red."""
    wrong = r"\b(not (?:proved|certified|enclosed)|NOT PROVED|REJECTED|FAILED|rejected|(?<=: )failed)\b"
    if re.search(wrong, line):
        return re.sub(wrong, lambda word: click.style(word[0], fg="red", bold=True), line)
    return re.sub(r"\b(certified|proved)\b", lambda word: click.style(word[0], fg="green"), line)


def finish(kind: str, document: Entries, passed: bool = True) -> None:
    """The end of a command: its document, records and arrays in plain numbers, where --json was given; exit code 1 for
    what did not pass.

    `OrbitfinderError` where a file that it says was written is not there, or is two results' at once.
    """
    document = plain(document)
    entries = [document, *(result for result in document.get("results", ()) if isinstance(result, dict))]
    written = Counter(
        str(file) for entry in entries if isinstance(entry.get("written"), list | tuple) for file in entry["written"]
    )
    for file, count in written.items():
        if count > 1 or not Path(file).exists():
            what = f"{count} results were written there, each over the one before" if count > 1 else "was not written"
            raise OrbitfinderError(f"{file}: {what}; please report this, with the command")
    if wants_json():
        print_json({"format": f"orbitfinder/{kind}"} | document)
    if not passed:
        click.get_current_context().exit(NOT_CERTIFIED)


def print_json(document: Any) -> None:
    """One JSON document on standard output, null for what JSON has no number for."""
    click.echo(json.dumps(finite(document), indent=1, allow_nan=False, default=os.fspath))


def picked(records: Iterable[Any], names: str) -> list[Entries]:
    """What `--json` says of some records: each one's attributes of these names."""
    return [{name: getattr(record, name) for name in names.split()} for record in records]


def trusted(file: Path, trust: bool) -> Path | None:
    """The folder of a file, with --trust, whose modules may make its system."""
    return file.parent.resolve() if trust else None


def out_option(what: str, **more: Any) -> Decorator:
    """The option -o, --out: where the command writes."""
    return click.option("-o", "--out", type=FILES, help=what, **more)


def _remember_compile(context: click.Context, _: click.Parameter, value: str | None) -> None:
    """Put the mode where worker processes find it too, for as long as the command runs."""
    if value is None:
        return
    context.with_resource(children_see({"ORBITFINDER_COMPILE": value}))
    if value == "on":
        with limited(context.params.get("limit")):
            from orbitfinder.integrate.compiled import available

            works, reason = available()
        if not works:
            click.echo(f"--compile on: {reason}; running interpreted", err=True)


compile_option: Decorator = click.option(
    "--compile", "compile_mode", type=click.Choice(("on", "off", "auto")), default=None, expose_value=False,
    callback=_remember_compile, help="Compiled equations: always, never, or where it pays (auto, the default).",
)  # fmt: skip


def option(name: str, what: str, default: Any = None, kind: Any = None, **more: Any) -> Decorator:
    """An option, its help and default, which is shown where there is any.

    `kind` is a type, bool for a switch, a range of whole numbers (least,) or (least, most), or words to choose from.
    """
    if isinstance(kind, tuple | list):
        kind = click.Choice(list(kind)) if isinstance(kind[0], str) else click.IntRange(*kind)
    names = [f"--{word}" for word in name.split()[:1]] + name.split()[1:]
    more |= {"is_flag": True} if kind is bool else {"type": kind}
    more |= {} if default is None else {"default": default, "show_default": default != ""}
    return click.option(*names, help=what, **more)


def workers_option(count: int = 1, what: str = "Processes side by side.", least: int = 1) -> Decorator:
    """The options --workers, so many by default, and --scheduler."""
    address = "Dask scheduler, such as tcp://head:8786, instead of processes."
    after = option("scheduler", address, metavar="ADDRESS")
    return lambda command: option("workers", what, count, (least, 256))(after(command))


def usual(
    out: str = "", into: Any = None, *, figures: str = "", compiled: bool = False, trust: str = TRUST, json: bool = True
) -> Decorator:
    """The options that most commands have: --out, --figures, --compile, --trust and --json, those that apply."""
    chosen: list[Decorator] = []
    if out:
        chosen.append(out_option(out, default=into, show_default=into is not None))
    if figures:
        chosen.append(option("figures/--no-figures", figures, True))
    chosen += (
        [compile_option] * compiled
        + [click.option("--trust", is_flag=True, help=trust)] * bool(trust)
        + [json_option] * json
    )
    return lambda command: functools.reduce(lambda run, add: add(run), reversed(chosen), command)


def limit_option(default: float | None = None, each: str = "") -> click.Option:
    """The option --limit: of the whole command, or (named by `each`) of each of its parts, which then gets `limit`."""

    def hold(context: click.Context, _: click.Parameter, value: float | None) -> float | None:
        if not each:
            context.find_root().with_resource(limited(value))  # click closes no context whose options it refuses
        return value

    what = f"Stop {each or 'the command'} after this time; what is finished by then is kept."
    return click.Option(
        ["--limit"], type=click.FloatRange(0.0, min_open=True), default=default, show_default=default is not None,
        metavar="SECONDS", callback=hold, expose_value=bool(each), help=what, is_eager=True,
    )  # fmt: skip
