#!/usr/bin/env python3
"""Checks the words of the project: doc comments of Rust and sentences of the pages.

A doc comment belongs to one item and can be read alone: each of its paragraphs begins with a capital letter, a digit or a
code span, and none ends in a comma. A sentence on a page has at most 35 words. Usage: tests/words.py
"""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
LONGEST = 35
PAGES = ["docs/*.md", "README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
DOC = re.compile(r"^\s*//[/!](?!/) ?(.*)$")
END_OF_SENTENCE = re.compile(r"(?<=[.!?])[)*_\"`]*\s+")
ABBREVIATIONS = ("e.g.", "i.e.", "etc.", "cf.", "vs.", "No.")


def doc_comments(path):
    """Yields (line number, lines) of each run of doc comment lines, without what is between code fences."""
    start, run, style = 0, [], None
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines() + [""], 1):
        found = DOC.match(line)
        kind = line.strip()[:3] if found else None
        if run and kind != style:
            yield start, run
            run = []
        if found:
            if not run:
                start, style = number, kind
            run.append(found.group(1))


def paragraphs(lines):
    """Yields (offset, text) of each paragraph and list entry."""
    offset, text, fenced = 0, [], False
    for index, line in enumerate([*lines, ""]):
        if line.lstrip().startswith("```"):
            fenced = not fenced
            line = ""
        elif fenced:
            line = ""
        entry = re.match(r"\s*(?:[-*+]|\d+\.)\s+(?=\S)", line)
        if text and (not line.strip() or entry):
            yield offset, " ".join(text)
            text = []
        if line.strip():
            if not text:
                offset = index
            text.append(line[entry.end() :] if entry else line.strip())


def check_comments(path):
    """Complaints about the doc comments of one file."""
    for start, lines in doc_comments(path):
        for offset, text in paragraphs(lines):
            if re.sub(r"^[*_\[]+", "", text)[:1].islower():
                yield start + offset, f"a doc comment begins in lower case: {text[:60]}"
            if text.endswith(","):
                yield start + offset, f"a doc comment ends in a comma: ...{text[-60:]}"
            elif not re.search(r"[.!?:`|)>\"$*]$", text) and not text.startswith(("|", "#")):
                yield start + offset, f"a doc comment ends within a sentence: ...{text[-60:]}"


def page_texts(path):
    """Yields (line number, text) of each paragraph, list entry, heading and table cell."""
    lines, fenced, comment = [], False, False
    for line in path.read_text(encoding="utf-8").splitlines():
        if re.match(r"\s*(```|~~~)", line):
            fenced, line = not fenced, ""
        elif fenced or line.startswith(("<", "    ")) and not re.match(r"\s+[-*\w(`\[]", line):
            line = ""
        lines.append(line)
    prose = []
    for number, line in enumerate(lines, 1):
        if line.lstrip().startswith("|"):
            for cell in re.split(r"(?<!\\)\|", line.strip().strip("|")):
                yield number, cell.strip()
            prose.append("")
        elif line.startswith("#"):
            yield number, line.lstrip("# ")
            prose.append("")
        else:
            prose.append(line)
    for offset, text in paragraphs(prose):
        yield offset + 1, text


def words(sentence):
    """The words of a sentence: a code span or a link's target is one."""
    sentence = re.sub(r"\]\([^)]*\)", "]", sentence)
    sentence = re.sub(r"`[^`]*`", "code", sentence)
    return [word for word in sentence.split() if re.search(r"\w", word)]


def sentences(text):
    """The sentences of a text."""
    for short in ABBREVIATIONS:
        text = text.replace(short + " ", short + "\u00a0")
    return END_OF_SENTENCE.split(text)


def check_page(path):
    """Complaints about the sentences of one page."""
    for number, text in page_texts(path):
        for sentence in sentences(text):
            count = len(words(sentence))
            if count > LONGEST:
                yield number, f"a sentence of {count} words, {LONGEST} at most: {sentence[:70]}..."


def main():
    """Prints all complaints, and fails if there are any."""
    complaints = []
    folders = [ROOT / name for name in ("src", "tests", "clients", "build.rs")]
    for folder in folders:
        files = [folder] if folder.is_file() else sorted(folder.rglob("*.rs"))
        for path in files:
            if "target" not in path.relative_to(ROOT).parts:
                complaints += [(path, *found) for found in check_comments(path)]
    for pattern in PAGES:
        for path in sorted(ROOT.glob(pattern)):
            complaints += [(path, *found) for found in check_page(path)]
    for path, number, text in complaints:
        print(f"{path.relative_to(ROOT)}:{number}: {text}")
    return 1 if complaints else 0


if __name__ == "__main__":
    sys.exit(main())
