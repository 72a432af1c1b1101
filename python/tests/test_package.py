"""The package as a whole: types, version, notebook, documents."""

from __future__ import annotations

import ast
import json
import re
import runpy
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest

import ridged
import ridged.bluesky
from conftest import ROOT, Daemon

PACKAGE = ROOT / "python/src/ridged"
NOTEBOOKS = sorted((ROOT / "python/notebooks").glob("*.ipynb"))


def declarations(source: str) -> dict[str, set[str]]:
    """Fields of each class with their types, and the literals of each alias."""
    found: dict[str, set[str]] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef):
            fields = [part for part in node.body if isinstance(part, ast.AnnAssign)]
            found[node.name] = {ast.unparse(part) for part in fields}
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            parts = [ast.unparse(part) for part in ast.walk(node.value) if isinstance(part, ast.Constant)]
            found[node.targets[0].id] = set(parts)
    return found


def test_the_types_are_those_of_the_document() -> None:
    """Fields that the API gains are no error; `tools/python_types.py` adds them."""
    fresh = declarations(runpy.run_path(str(ROOT / "tools/python_types.py"))["text"]())
    kept = declarations((PACKAGE / "_api.py").read_text())
    assert len(kept) > 50
    for name, parts in kept.items():
        gone = parts - fresh.get(name, set())
        assert not gone, f"{name}: {gone} is not in the document; run tools/python_types.py"


def test_package_and_program_have_one_version() -> None:
    program = tomllib.loads((ROOT / "Cargo.toml").read_text())["package"]["version"]
    package = tomllib.loads((ROOT / "python/pyproject.toml").read_text())["project"]["version"]
    assert ridged.__version__ == package == program


def test_the_wheel_has_the_package_and_its_types(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT / "python", check=True, capture_output=True)
    [wheel] = tmp_path.glob("ridged-*-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        [metadata] = [archive.read(name).decode() for name in names if name.endswith("METADATA")]
    assert {"ridged/__init__.py", "ridged/bluesky.py", "ridged/py.typed"} <= names
    needed = [line for line in metadata.splitlines() if line.startswith("Requires-Dist") and "extra" not in line]
    assert needed == ["Requires-Dist: httpx>=0.27"]


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_is_kept_without_outputs(
    path: Path, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(PACKAGE.parent))
    kept = json.loads(path.read_text())
    for cell in kept["cells"]:
        assert not cell.get("outputs") and cell.get("execution_count") is None, "strip the outputs before a commit"
    notebook = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(daemon.folder)}}
    )
    client.execute()
    shown: list[Any] = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    html = [output["data"] for output in shown if "text/html" in output.get("data", {})]
    pictures = [output["data"] for output in shown if "image/png" in output.get("data", {})]
    assert html and pictures, "a table and a plot are shown"


def names_of(block: str) -> set[str]:
    """Attributes that Python in a document uses of the objects of this package."""
    return set(re.findall(r"\b(?:ridged|lab|scan|fit|rig|lab\.rig)\.(\w+)", block))


@pytest.mark.parametrize("document", ["README.md", "docs/reference/python.md", "python/README.md"])
def test_documents_name_what_the_package_has(document: str) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)
    assert blocks, f"{document} has an example"
    owners = [ridged, ridged.Lab, ridged.Scan, ridged.Fit, ridged.Rig, ridged.RigStatus]
    fields = ridged.bluesky.Devices.__dataclass_fields__
    known = set().union(*(dir(owner) for owner in owners), fields) | {"rig", "who", "role", "body"}
    for block in blocks:
        compile(block, document, "exec")
        unknown = names_of(block) - known
        assert not unknown, f"{document}: {unknown}"
