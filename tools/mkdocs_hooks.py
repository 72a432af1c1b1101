"""Hooks of the site: links to files of the repository outside `docs/`, and files that a page shows."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"

LINK = re.compile(r"\[([^\]]+)\]\(((?:\.\./)+[^)#\s]+)\)")
SHOWN = re.compile(r"<!-- file: (\S+) -->")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turns links that leave `docs/` into the paths of the files, and puts shown files in. A file that is missing ends the build."""
    folder = (DOCS / page.file.src_uri).parent

    def path_of(found: re.Match[str]) -> str:
        target = (folder / found[2]).resolve()
        if target.is_relative_to(DOCS):
            return found[0]
        if not target.exists():
            raise FileNotFoundError(f"{page.file.src_uri}: {found[2]} does not exist")
        text = found[1].strip("`")
        path = target.relative_to(ROOT)
        return f"{text} (`{path}` in the repository)" if text not in (str(path), path.name) else f"`{path}`"

    def content_of(found: re.Match[str]) -> str:
        file = ROOT / found[1]
        return f"```{file.suffix.removeprefix('.')}\n{file.read_text()}```"

    return SHOWN.sub(content_of, LINK.sub(path_of, markdown))
