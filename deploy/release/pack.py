#!/usr/bin/env python3
"""Packs a folder as NAME.tar.gz and writes SHA256SUMS. The same files give the same bytes on every system.

Usage: pack.py FOLDER OUT [FILE...]
The archive has the folder's own name and goes to OUT; the FILEs lie in OUT and get a checksum too. Times are SOURCE_DATE_EPOCH.
Needs Python 3.11 and nothing else.
"""

import gzip
import hashlib
import os
import sys
import tarfile
from pathlib import Path


def cleaned(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    """Without the machine that packs: owner, times, and permissions beyond those of a program or a file."""
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    entry.mtime = int(os.environ["SOURCE_DATE_EPOCH"])
    entry.mode = 0o755 if entry.isdir() or entry.name.split("/")[1:2] == ["bin"] else 0o644
    return entry


def main() -> None:
    folder, out, others = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    archive = out / f"{folder.name}.tar.gz"
    with open(archive, "wb") as file, gzip.GzipFile("", "wb", 9, file, mtime=0) as packed:
        with tarfile.open(fileobj=packed, mode="w", format=tarfile.GNU_FORMAT) as tar:
            # Folders come in the order of their names.
            tar.add(folder, folder.name, filter=cleaned)
    names = sorted([archive.name, *others])
    sums = [f"{hashlib.sha256((out / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (out / "SHA256SUMS").write_text("".join(sums), encoding="utf-8", newline="\n")
    print(f"{archive}  {archive.stat().st_size} bytes")


if __name__ == "__main__":
    main()
