"""Notebooks as pages, with what they show; and the stage of a family, which notebooks have as a widget, on a page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import nbformat

ROOT = Path(__file__).parents[1]
MARKER = re.compile(r"<!-- (notebook|stage): (\S+) -->")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace `<!-- notebook: NAME -->` by a stored notebook and `<!-- stage: FILE -->` by the family of a file."""
    return MARKER.sub(lambda found: MAKERS[found.group(1)](found.group(2)), markdown)


def notebook(name: str) -> str:
    """The cells of a stored notebook but its title as Markdown: text, code, and below it what it showed."""
    cells = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", 4).cells
    cells[0].source = cells[0].source.partition("\n")[2]
    return "\n\n".join(
        cell.source if cell.cell_type == "markdown" else "\n\n".join(code(cell)) for cell in cells
    )


def code(cell: Any) -> list[str]:
    """A cell of code and its outputs."""
    return [f"```python\n{cell.source}\n```", *map(output, cell.outputs)]


def output(one: Any) -> str:
    """What a cell printed, or showed: one block of HTML, without empty lines."""
    data = one.get("data", {})
    if "text/html" in data:
        return f'<div class="shown">{" ".join(data["text/html"].split())}</div>'
    return f"```text\n{(one.get('text') or data['text/plain']).rstrip()}\n```"


def stage(file: str) -> str:
    """The widget of a family without its kernel; where anywidget is missing, what stands beside the widget."""
    from orbitfinder import load_family
    from orbitfinder.errors import InputError

    family = load_family(ROOT / file)
    try:
        shown = family.widget()
    except InputError:
        return str(family._repr_html_())
    state = json.dumps(
        {name: getattr(shown, name) for name in ("shown", "index", "playing", "speed")}
    )
    script = MOUNTED % (
        shown._esm.replace("export default { render };", ""),
        state.replace("</", "<\\/"),
    )
    whole = f'<style>{shown._css}</style><script type="module">\n{script}\n</script>'
    return '<div id="stage"></div>' + re.sub(
        r"\n+", "\n", whole
    )  # Markdown ends a block at an empty line


MOUNTED = """%s
const state = %s;
const model = {
  get: key => state[key], set: (key, value) => { state[key] = value; }, save_changes() {}, on() {}, off() {},
};
render({ model, el: document.getElementById("stage") });"""
"""The module of the widget, and a model that nobody listens to"""

MAKERS = {"notebook": notebook, "stage": stage}
