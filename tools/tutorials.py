#!/usr/bin/env python3
"""Runs the commands of the tutorials, each page in an empty folder.

    cargo build --release
    python3 tools/tutorials.py [--srflow target/release/srflow] [docs/tutorials/PAGE.md ...]

A page is run as one script: its ```sh blocks in order. Blocks marked ```sh,ignore are skipped. Prints the seconds of each page; stops
at the first command that fails.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", type=Path, default=sorted((ROOT / "docs/tutorials").glob("*.md")))
    parser.add_argument("--srflow", type=Path, default=ROOT / "target/release/srflow")
    args = parser.parse_args()
    if not args.srflow.is_file():
        sys.exit(f"{args.srflow}: not found; build it with `cargo build --release`")
    environment = {**os.environ, "PATH": f"{args.srflow.resolve().parent}{os.pathsep}{os.environ['PATH']}"}
    for page in args.pages:
        blocks = re.findall(r"^```sh\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
        with tempfile.TemporaryDirectory() as folder:
            start = time.monotonic()
            status = subprocess.run(["bash", "-euxc", "\n".join(blocks)], cwd=folder, env=environment).returncode
        if status != 0:
            sys.exit(f"{page}: a command ended with {status}")
        print(f"{page}: {time.monotonic() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
