"""Text of files and of people within another language, where it stands for nothing but itself."""

from __future__ import annotations

import html
import json
import re


def inert(text: object, language: str = "html") -> str:
    """A text as a line of a "comment" (C, Fortran, Julia, Python, TOML: ASCII without backslashes), as "html" or SVG,
    attributes included, or as a quoted "toml" string."""
    if language == "comment":
        plain = re.sub(r"[^ -~]|\\", "?", " ".join(str(text).split()))
        # where a comment would begin, end, go on in the next line (C's trigraph) or say a file's encoding (PEP 263)
        return re.sub(r"(?<=[*?])(?=/)|(?<=/)(?=\*)|(?<=coding)(?=[:=])", " ", plain)
    if language == "html":
        return html.escape(str(text), quote=True)
    return json.dumps(str(text), ensure_ascii=False).replace("\x7f", "\\u007f")
