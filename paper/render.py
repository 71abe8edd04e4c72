"""Pandoc resolves citations and writes Typst, Typst writes the PDF; both come from PyPI. Called by build.sh."""

from __future__ import annotations

import sys
from pathlib import Path

import pypandoc
import typst

HERE = Path(__file__).parent


def main() -> None:
    """The PDF at the path that is given."""
    out, source = sys.argv[1], HERE / "paper.typ"
    arguments = ["--citeproc", f"--template={HERE / 'template.typ'}", "--metadata=link-citations:true"]
    pypandoc.convert_file(str(HERE / "paper.md"), "typst", extra_args=arguments, outputfile=str(source))
    try:
        typst.compile(str(source), output=out, root=str(HERE.parent))
    finally:
        source.unlink()


if __name__ == "__main__":
    main()
