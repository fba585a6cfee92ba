#!/usr/bin/env python3
"""Says what the program is made of: licences with their texts, and a bill of materials (CycloneDX 1.5, JSON).

Usage: notices.py licences|sbom [--target TRIPLE]

Reads `cargo metadata --locked` and Cargo.lock. The output depends on these, the licence files of the packages and
SOURCE_DATE_EPOCH alone. Needs Python 3.11 and nothing else.

  licences  the text that has to go with the program
  sbom      the bill of materials

deny.toml says which licences there may be.
"""

import argparse
import datetime
import hashlib
import json
import os
import re
import subprocess
import tomllib
import uuid
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMES = re.compile(r"(licen[cs]e|copying|notice|unlicen[cs]e|copyright)", re.IGNORECASE)


def packages(target):
    """The packages that are linked into the program, and who depends on whom. Packages for builds and tests are not in it."""
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", target]
    said = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout
    metadata = json.loads(said)
    by_id = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    edges, to_do = {}, [metadata["resolve"]["root"]]
    while to_do:
        package = to_do.pop()
        if package in edges:
            continue
        deps = nodes[package]["deps"]
        edges[package] = sorted(d["pkg"] for d in deps if any(kind["kind"] is None for kind in d["dep_kinds"]))
        to_do.extend(edges[package])
    order = sorted(edges, key=lambda i: (by_id[i]["name"], by_id[i]["version"]))
    return [by_id[i] for i in order], edges, metadata["resolve"]["root"]


def expression(package):
    """The licence as SPDX writes it; older packages have a slash for OR."""
    return re.sub(r"\s*/\s*", " OR ", package["license"] or "NOASSERTION")


def license_files(package):
    """The files with its licences. Where the MIT licence will do and has a file of its own, the others are left out."""
    folder = Path(package["manifest_path"]).parent
    files = sorted(path for path in folder.iterdir() if path.is_file() and NAMES.match(path.name))
    mit = [path for path in files if "MIT" in path.name.upper()]
    if mit and is_allowed(expression(package), {"MIT"}):
        return [path for path in files if path in mit or path.name.upper().startswith("NOTICE")]
    return files


def licences(found, _edges, root):
    others = [package for package in found if package["id"] != root]
    texts = {}
    for package in others:
        for path in license_files(package):
            text = path.read_text(encoding="utf-8", errors="replace").replace("\r\n", "\n").strip("\n")
            key = " ".join(text.split())
            texts.setdefault(key, (text, []))[1].append(f"{package['name']} {package['version']}")
    out = ["Tessera contains the following packages. Their licences come after the list.", ""]
    width = max(len(package["name"]) + len(package["version"]) for package in others) + 2
    for package in others:
        out.append(f"{package['name'] + ' ' + package['version']:<{width}} {expression(package)}")
    bare = [package for package in others if not license_files(package)]
    if bare:
        out += ["", "These packages come without a file of their licence; its text is the one of SPDX for the name above:", ""]
        out += [f"{package['name']} {package['version']}  {package['repository'] or ''}".rstrip() for package in bare]
    for text, users in sorted(texts.values(), key=lambda entry: entry[1]):
        out += ["", "=" * 100, ", ".join(sorted(set(users))), "-" * 100, text]
    print("\n".join(out))


def sbom(found, edges, root):
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))
    checksums = {(package["name"], package["version"]): package.get("checksum") for package in lock["package"]}

    def purl(package):
        return f"pkg:cargo/{package['name']}@{package['version']}"

    def component(package):
        made = {
            "type": "application" if package["id"] == root else "library",
            "bom-ref": purl(package),
            "name": package["name"],
            "version": package["version"],
            "purl": purl(package),
            "licenses": [{"expression": expression(package)}],
        }
        if package["description"]:
            made["description"] = " ".join(package["description"].split())
        if checksum := checksums.get((package["name"], package["version"])):
            made["hashes"] = [{"alg": "SHA-256", "content": checksum}]
        if package["repository"]:
            made["externalReferences"] = [{"type": "vcs", "url": package["repository"]}]
        return made

    by_id = {package["id"]: package for package in found}
    parts = [component(package) for package in found if package["id"] != root]
    depends = [
        {"ref": purl(package), "dependsOn": sorted({purl(by_id[i]) for i in edges[package["id"]]})} for package in found
    ]
    digest = hashlib.sha256(json.dumps([parts, depends], sort_keys=True).encode()).digest()
    when = datetime.datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH") or 0), datetime.timezone.utc)
    bill = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        # Made of what is listed, so that the same list has the same number.
        "serialNumber": f"urn:uuid:{uuid.UUID(bytes=digest[:16], version=4)}",
        "version": 1,
        "metadata": {"timestamp": when.strftime("%Y-%m-%dT%H:%M:%SZ"), "component": component(by_id[root])},
        "components": parts,
        "dependencies": depends,
    }
    print(json.dumps(bill, indent=1, ensure_ascii=False))


def is_allowed(text, allowed):
    """Whether somebody who accepts the `allowed` licences can take what `text`, an SPDX expression, offers."""
    words = re.findall(r"\(|\)|[^\s()]+", text)

    def any_of():
        good = all_of()
        while words and words[0] == "OR":
            words.pop(0)
            good = all_of() or good
        return good

    def all_of():
        good = one()
        while words and words[0] == "AND":
            words.pop(0)
            good = one() and good
        return good

    def one():
        word = words.pop(0)
        if word == "(":
            good = any_of()
            words.pop(0)
            return good
        if words and words[0] == "WITH":
            word = f"{word} {words.pop(0)} {words.pop(0)}"
        return word in allowed

    return any_of()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("what", choices=["licences", "sbom"])
    parser.add_argument("--target", default="x86_64-unknown-linux-gnu", metavar="TRIPLE")
    args = parser.parse_args()
    {"licences": licences, "sbom": sbom}[args.what](*packages(args.target))


if __name__ == "__main__":
    main()
