"""The commands `problems ...`: the problem files that come with orbitfinder, without a clone."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import click

from orbitfinder.cli.options import finish, json_option, next_step, option, picked, text, usual
from orbitfinder.errors import InputError, closest, plural


@click.group(name="problems")
def problems() -> None:
    """List, show and copy the problem files that come with orbitfinder.

    \b
    Example:
      orbitfinder problems copy triple-1 && orbitfinder run problems/report/triple-1.toml
    """


@problems.command(name="list")
@click.argument("kind", required=False)
@json_option
def list_(kind: str | None) -> None:
    """List the problem files that come with orbitfinder, all or of one KIND, each with its title.

    \b
    Examples:
      orbitfinder problems list
      orbitfinder problems list hybrid
    """
    from orbitfinder.problemfile.shipped import KINDS, shipped

    if kind is not None and kind not in KINDS:
        raise InputError(f"KIND: {kind!r} is unknown{closest(kind, KINDS) or '; there are ' + ', '.join(KINDS)}")
    files = [file for file in shipped() if kind in (None, file.kind)]
    for name, group in groupby(files, lambda file: file.kind):
        rows = list(group)
        text(f"{name}: {KINDS[name]}")
        for row in rows:
            text(f"  {row.name:<{max(len(other.name) for other in rows)}}  {row.title}")
    text(f"{plural(len(files), 'problem file')}; orbitfinder problems copy NAME, KIND or all")
    finish("problems", {"problems": picked(files, "name kind title command")})


@problems.command()
@click.argument("name")
@json_option
def show(name: str) -> None:
    """Print the problem file NAME.

    \b
    Example:
      orbitfinder problems show triple-1
    """
    from orbitfinder.problemfile.shipped import KINDS, chosen

    if name in (*KINDS, "all"):
        raise InputError(f"NAME: {name!r} is more than one file; see `orbitfinder problems list`")
    (file,) = chosen([name])
    content = file.path.read_text(encoding="utf-8")
    text(content.rstrip())
    finish("problem", picked([file], "name kind title command")[0] | {"text": content})


@problems.command()
@click.argument("names", nargs=-1, required=True, metavar="NAME|KIND|all...")
@option("force", "Overwrite files that are there already and differ.", kind=bool)
@usual("The folder that gets a folder for each kind.", Path("problems"), trust="")
def copy(names: tuple[str, ...], out: Path, force: bool) -> None:
    """Copy problem files, with what they name, to problems/KIND/: one NAME, one KIND or all.

    \b
    Examples:
      orbitfinder problems copy all
      orbitfinder problems copy triple-1 hybrid -o my-problems
    """
    from orbitfinder.problemfile.shipped import chosen
    from orbitfinder.problemfile.shipped import copy as write

    files = chosen(names)
    written = write(files, out, force)
    for path in written if len(written) <= 20 else ():
        text(f"{path}: written")
    if len(written) > 20:
        text(f"{plural(len(written), 'problem file')} written to {out}")
    next_step(files[0].command, written[0], *(["--trust"] if written[0].suffix == ".py" else []))
    finish("copies", {"written": written})
