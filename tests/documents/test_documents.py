"""The documents name what the source has: codes, warnings, parameters, and files that exist."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs/reference"
PAGES = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", ROOT / "python/README.md", *sorted((ROOT / "docs").rglob("*.md"))]

#: Words in the form of codes that are not codes.
NO_CODES = {"cap-lens", "place-sample", "place-white-reference", "not-over", "live-fit", "kebab-case"}
#: Where codes are: the errors of the API, of the lab and of the store, alarms, recoveries, failed work.
PLACES = ["api/status.rs", "api/status/*.rs", "lab/**/*.rs", "scan/visit.rs", "scan/runner.rs", "scan/runner/*.rs", "bench/stage/**/*.rs"]
#: Codes of one word are known by the function that returns them.
CODE_ARM = re.compile(r'=> (?:Some\()?"([a-z]+(?:-[a-z0-9]+)*)"')
CODE = re.compile(r'"([a-z]+(?:-[a-z0-9]+)+)"')


def program(text: str) -> str:
    """Source without its tests and comments."""
    text = text.split("#[cfg(test)]")[0]
    return re.sub(r"//[^\n]*", "", text)


def codes_of_source() -> set[str]:
    found = set()
    for place in PLACES:
        for file in (ROOT / "src").glob(place):
            if not file.stem.endswith("tests"):
                found |= set(CODE.findall(program(file.read_text())))
    for file in ("lab/error.rs", "scan/visit.rs"):
        found |= set(CODE_ARM.findall(program((ROOT / "src" / file).read_text())))
    return found - NO_CODES


def codes_of_page(page: str) -> set[str]:
    """Codes in the first column of the tables."""
    rows = [line for line in (REFERENCE / page).read_text().splitlines() if line.startswith("| `")]
    return {code for row in rows for code in re.findall(r"`([a-z0-9-]+)`", row.split(" | ")[0])}


def findings() -> set[str]:
    schema = json.loads((ROOT / "src/api/openapi.json").read_text())["components"]["schemas"]["FitFindingCode"]
    return set(schema["enum"])


def test_every_code_is_on_its_page_and_no_other() -> None:
    source, page = codes_of_source(), codes_of_page("codes.md")
    assert len(source) > 80
    # The findings of a fit are on the page of warnings.
    assert sorted(source - page - findings()) == [], "describe these in docs/reference/codes.md, or list them in NO_CODES"
    assert sorted(page - source) == [], "the source has no such codes: remove them from docs/reference/codes.md"
    assert codes_of_page("warnings.md") == findings()


def test_every_warning_of_the_page_is_in_the_source() -> None:
    text = " ".join(program(file.read_text()) for file in sorted((ROOT / "src/fit").rglob("*.rs")))
    # Lines of a Rust string are continued with a backslash; placeholders are where values come.
    text = re.sub(r"\\\n\s*", "", text)
    text = re.sub(r"\{[\w.:]*\}", "…", text)
    rows = (REFERENCE / "warnings.md").read_text().split("## Findings")[0].splitlines()
    rows = [row.split(" | ")[0].removeprefix("| ") for row in rows if row.startswith("| ")][2:]
    assert len(rows) >= 10
    for row in rows:
        for part in (part.strip() for part in row.split("…")):
            assert part in text, f"no warning of a fit has the words {part!r}"


def test_every_parameter_and_every_line_of_a_budget_is_in_the_glossary() -> None:
    schemas = json.loads((ROOT / "src/api/openapi.json").read_text())["components"]["schemas"]
    glossary = (REFERENCE / "glossary.md").read_text()
    named = set(schemas["FitParameters"]["properties"])
    for name in named:
        assert f"| `{name}` |" in glossary, name
    budget = re.findall(r'\("([a-z]+)", ', (ROOT / "src/fit/uncertainty/budget.rs").read_text())
    for line in budget:
        assert f"| `{line}` |" in glossary, f"the line {line} of the budget"


def test_every_file_that_a_document_links_exists() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
            if not re.match(r"[a-z]+:", target):
                assert (page.parent / target).exists(), f"{page.relative_to(ROOT)} links {target}"


def test_every_document_that_a_file_names_exists() -> None:
    folders = ["benches", "docs", "python/src", "python/tests", "src", "tests/documents", "tests/it", "tools", "web/src", "web/tests"]
    files = [*ROOT.glob("*"), ROOT / "src/api/openapi.json", *(file for folder in folders for file in (ROOT / folder).rglob("*"))]
    pictures = {".png", ".svg", ".pyc"}
    named = 0
    for file in (file for file in files if file.is_file() and file.suffix not in pictures):
        for path in re.findall(r"\bdocs/[\w./-]+\.(?:md|toml|svg|png|sh|service|rules)\b", file.read_text(errors="ignore")):
            assert (ROOT / path).exists(), f"{file.relative_to(ROOT)} names {path}"
            named += 1
    assert named > 80


def test_every_page_is_in_the_folder_of_its_part() -> None:
    parts = ("tutorial", "how-to", "reference", "explanation")
    for page in (ROOT / "docs").rglob("*.md"):
        place = page.relative_to(ROOT / "docs")
        assert place.parts[0] in (*parts, "index.md", "style.md"), f"docs/{place}: move it to one of {parts}"
