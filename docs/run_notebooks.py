"""Runs the notebooks in docs/notebooks and keeps what they print and draw: python docs/run_notebooks.py

Cell by cell in one namespace, as Jupyter does, whose lines that end in an expression show its value; Jupyter itself
is not needed. A test runs them as well and compares what they print with what is kept.
"""

import argparse
import ast
import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from swarmchase.files import write_text_atomically

NOTEBOOKS = Path(__file__).parent / "notebooks"
DOTS_PER_INCH = 90


def main() -> None:
    """Run all."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        for number, (cell, outputs) in enumerate(zip(code, run_cells(notebook), strict=True), start=1):
            cell["outputs"], cell["execution_count"] = outputs, number
        write_text_atomically(path, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


def run_cells(notebook: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """The outputs of each cell of code, as the format of notebooks has them."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    return [run_cell("".join(cell["source"]), namespace) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run_cell(source: str, namespace: dict[str, Any]) -> list[dict[str, Any]]:
    """What it prints, and the value of its last line where that is an expression."""
    tree, printed, value = ast.parse(source), io.StringIO(), None
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "<cell>", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "<cell>", "eval"), namespace)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": printed.getvalue().splitlines(keepends=True)}
        )
    if value is not None:
        outputs.append({"output_type": "execute_result", "metadata": {}, "execution_count": None, "data": shown(value)})
    return outputs


def shown(value: Any) -> dict[str, Any]:
    """A figure as a picture, all else in words."""
    if not isinstance(value, Figure):
        return {"text/plain": repr(value).splitlines(keepends=True)}
    picture = io.BytesIO()
    value.savefig(picture, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
    return {"image/png": base64.b64encode(picture.getvalue()).decode()}


if __name__ == "__main__":
    main()
