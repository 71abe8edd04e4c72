"""`python -m benchmarks.validation`: compute the page, exit 1 when a row fails."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks.validation.page import collect, write
from orbitfinder.errors import InputError
from orbitfinder.integrate.compiled import compiling

FOLDERS = click.Path(path_type=Path)


@click.command()
@click.option("--out", default="results/validation", show_default=True, type=FOLDERS, help="Folder for README.md.")
@click.option("--data", default="tests/data", show_default=True, type=FOLDERS, help="Folder of the reference orbits.")
@click.option("--families", default="results/families", show_default=True, type=FOLDERS, help="Folder of families.")
def main(out: Path, data: Path, families: Path) -> None:
    """Compare with every published number that we know of and write README.md. Takes about two minutes.

    \b
    Example:
      python -m benchmarks.validation
    """
    try:
        with compiling("off"):  # so that the last digits do not depend on what is in a cache
            sections = collect(data, families)
    except InputError as error:
        click.echo(f"Error: {error}", err=True)
        raise SystemExit(2) from error
    path = write(sections, out)
    rows = [row for section in sections for row in section.rows]
    failures = [row for row in rows if not row.passed]
    click.echo(f"{path}: {len(rows) - len(failures)} of {len(rows)} rows pass")
    for row in failures:
        click.echo(f"  FAIL {row.quantity}: published {row.published}, ours {row.ours} {row.note}".rstrip())
    raise SystemExit(1 if failures else 0)


if __name__ == "__main__":
    main()
