"""Run the notebooks and keep what they show, so that a reader on GitHub and of the documentation sees it.

    python notebooks/run.py [NAME.ipynb ...]

What is kept is what shows without a program: no views of widgets (the static display stands beside them), no plain text
beside a display, no messages on stderr, no times.
"""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
KEPT = ("text/html", "image/png", "text/plain")
"""What is kept of an output: the first of these that it has"""


def executed(path):
    """A notebook run from its first cell, its outputs cleaned."""
    notebook = nbformat.read(path, 4)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", store_widget_state=False, record_timing=False)
    client.execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [cleaned(one) for one in cell.outputs if one.get("name") != "stderr"]
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return notebook


def cleaned(output):
    """An output without what only a running kernel can show."""
    if "data" in output:
        best = next(kind for kind in KEPT if kind in output["data"])
        output["data"] = {best: output["data"][best]}
        output["metadata"] = {}
    return output


if __name__ == "__main__":
    for path in map(Path, sys.argv[1:]) if sys.argv[1:] else sorted(HERE.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(f"{path.name}: {path.stat().st_size // 1000} kB")
