#!/usr/bin/env python3
"""Makes a book of the pages that can be searched, with mdBook. Its chapters are those of docs/README.md, in that order.

Usage: docs/book.py [FOLDER] [--mdbook PROGRAM]
FOLDER gets the pages as HTML; target/book if not given. Open its index.html. The environment that `tests/python/venv.sh` makes has
mdBook. Fails if mdBook warns, or if the search does not find every page. Needs Python 3.11 and nothing else.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONFIG = """\
[book]
title = "Tessera"
language = "en"
[output.html]
no-section-label = true
smart-punctuation = false
[output.html.search]
limit-results = 30
[output.html.print]
enable = false
"""


def chapters(index: str) -> list[str]:
    """The lines of mdBook's SUMMARY.md: a part for each heading, a chapter for each row of its table."""
    lines = ["# Summary", "", "[Tessera](README.md)", "[All pages](docs/README.md)"]
    for line in index.splitlines():
        if found := re.match(r"## (.*)", line):
            lines += ["", f"# {found[1]}", ""]
        elif found := re.match(r"\| \[(.*?)\]\((.*?)\) \|", line):
            page = Path("docs", found[2])
            lines.append(f"- [{found[1]}]({(ROOT / page).resolve().relative_to(ROOT)})")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "target" / "book")
    parser.add_argument("--mdbook", default="mdbook")
    arguments = parser.parse_args()
    summary = chapters((ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as work:
        book = Path(work)
        (book / "book.toml").write_text(CONFIG, encoding="utf-8")
        # The same folders as here, so that links stay right.
        shutil.copytree(ROOT / "docs", book / "src" / "docs", ignore=shutil.ignore_patterns("book.py"))
        shutil.copytree(ROOT / ".readme", book / "src" / ".readme", ignore=shutil.ignore_patterns("*.sh"))
        for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE"):
            shutil.copy(ROOT / name, book / "src")
        (book / "src" / "SUMMARY.md").write_text("\n".join(summary) + "\n", encoding="utf-8")
        done = subprocess.run([arguments.mdbook, "build", book, "--dest-dir", arguments.folder.resolve()], stderr=subprocess.PIPE, text=True)
        if done.returncode != 0 or "WARN" in done.stderr or "ERROR" in done.stderr:
            sys.exit(done.stderr)
    search = "".join(file.read_text(encoding="utf-8") for file in arguments.folder.glob("searchindex*.js"))
    pages = re.findall(r"\]\((.*?)\.md\)", "\n".join(summary))
    missing = [page for page in pages if f"{page}.html" not in search and not page.endswith("README")]
    pictures = [path for path in arguments.folder.rglob("*.html") for path in lost_pictures(path)]
    if missing or pictures:
        sys.exit(f"the search does not find {missing}; pictures are missing: {pictures}")
    print(f"{arguments.folder / 'index.html'}: {len(pages)} pages")


def lost_pictures(page: Path) -> list[str]:
    """Pictures of a page that are not beside it."""
    sources = re.findall(r'<img[^>]* src="([^"]+)"', page.read_text(encoding="utf-8"))
    return [f"{page.name}: {source}" for source in sources if "://" not in source and not (page.parent / source).exists()]


if __name__ == "__main__":
    main()
