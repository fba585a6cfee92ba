#!/usr/bin/env python3
"""Checks what a release says of itself: one version everywhere, and the address of the sources.

Usage: check_version.py [REF [ADDRESS]]
REF is what is built, as refs/tags/v0.1.0; other refs name no version. A tag needs ADDRESS as `repository` of the program, where
`cargo binstall` finds the archives, and of the Python package, whose page links to it. Needs Python 3.11 and nothing else.
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def load(path: str) -> dict:
    return tomllib.loads((ROOT / path).read_text(encoding="utf-8"))


def main() -> None:
    workspace, package = load("Cargo.toml")["workspace"]["package"], load("clients/python/Cargo.toml")["package"]
    faults = []
    image = re.search(r"^ARG VERSION=(.*)$", (ROOT / "deploy/Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    if image is None or image[1] != workspace["version"]:
        faults.append(f"deploy/Dockerfile has another version than {workspace['version']}")
    if package["version"] != workspace["version"]:
        faults.append(f"clients/python/Cargo.toml has version {package['version']}, Cargo.toml {workspace['version']}")
    ref, address = [*sys.argv[1:3], "", ""][:2]
    if ref.startswith("refs/tags/v"):
        if ref != f"refs/tags/v{workspace['version']}":
            faults.append(f"the tag is {ref}, the version {workspace['version']}")
        root = load("Cargo.toml")["package"]
        for name, found in (("Cargo.toml", root), ("clients/python/Cargo.toml", package)):
            if found.get("repository") != address:
                faults.append(f"`repository` of {name} is {found.get('repository')}, the sources are at {address}")
        if f"## {workspace['version']}" not in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"):
            faults.append(f"CHANGELOG.md has no heading {workspace['version']}")
    if faults:
        sys.exit("\n".join(faults))
    print(workspace["version"])


if __name__ == "__main__":
    main()
