"""Measures what srflow does around the pairs of large datasets: merging, checking, packing, opening, and finding out what is left to do.

    cargo build --release
    python3 tools/clusters/bookkeeping.py target/release/srflow FOLDER > table.md

One scene of tiny frames is rendered. Datasets of 1000 to 1,000,000 pairs have its files under many names, as hard links: every folder, file and
record is that of a rendered dataset. Their dataset.json states another version of srflow, since this one would compare the records with its own
plan, in which no two scenes are alike. FOLDER must be new, on a file system with hard links and with 30 GB free for a million pairs; it is removed
at the end. Time is that of the clock, memory the largest resident set of the process.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

FRAMES = 200  # pairs of a scene
KINDS = [("frames", "png"), ("alpha", "png"), ("mask", "png"), ("flow", "npz16"), ("occlusion", "png"), ("pairs", "json")]
OF_FRAMES = 3  # the first kinds, of which a scene has one more


def run(command, out, codes=(0,)):
    """Seconds and MB of a command, whose output goes to files beside `out`."""
    with open(out.with_suffix(".out"), "w") as stdout, open(out.with_suffix(".err"), "w") as stderr:
        start = time.monotonic()
        child = subprocess.Popen([str(word) for word in command], stdout=stdout, stderr=stderr)
        _, status, usage = os.wait4(child.pid, 0)
        seconds = time.monotonic() - start
    child.returncode = os.waitstatus_to_exitcode(status)  # so that nothing waits for it again
    if child.returncode not in codes:
        said = out.with_suffix(".err").read_text()[-2000:]
        sys.exit(f"{' '.join(map(str, command))}\nended with {child.returncode}, expected {codes}: {said}")
    return seconds, usage.ru_maxrss * 1024 / 1e6


def arguments(scenes, size, seed):
    return ["--scenes", scenes, "--frames", FRAMES, "--size", size, "--splits", "1,0,0", "--seed", seed]


def link_part(scene, part, pairs):
    """Links the files of the pairs with these numbers, counted over all scenes, into the folder of a part. Returns how many."""
    links, folders = 0, {}
    for number in pairs:
        at, pair = divmod(number, FRAMES)
        if at not in folders:
            folders = {at: [part / "train" / kind / f"scene-{at:04}" for kind, _ in KINDS]}
            for folder in folders[at]:
                folder.mkdir(parents=True)
        for kind, ((name, ending), folder) in enumerate(zip(KINDS, folders[at])):
            of_pair = [pair, pair + 1] if kind < OF_FRAMES and pair + 1 == FRAMES else [pair]
            for frame in of_pair:
                os.link(f"{scene}/{name}/scene-0000/{frame:05}.{ending}", f"{folder}/{frame:05}.{ending}")
                links += 1
    return links


def make_parts(srflow, folder, scene, pairs, count, options):
    """Folders of the parts of a dataset, and the number of its files."""
    planned = folder / "planned"
    run([srflow, "render", "--out", planned, "--stop-after", 0, *options], folder / "plan", codes=[75])
    manifest = json.loads((planned / "dataset.json").read_text())
    shutil.rmtree(planned)
    manifest["srflow_version"] = "0.0.0"
    parts, files = [], 0
    for number in range(count):
        part = folder / f"part-{number:04}"
        part.mkdir()
        (part / "dataset.json").write_text(json.dumps(manifest, indent=2) + "\n")
        files += link_part(scene, part, range(pairs * number // count, pairs * (number + 1) // count))
        parts.append(part)
    return parts, files


def measure(srflow, folder, scene, pairs, count, size, seed):
    folder.mkdir()
    whole, packed, one = folder / "whole", folder / "packed", folder / "one"
    options = arguments(pairs // FRAMES, size, seed)
    parts, files = make_parts(srflow, folder, scene, pairs, count, options)
    print(f"{pairs} pairs: {files} files in {count} parts", file=sys.stderr)

    # The last of as many parts as there are pairs, whose pair is there the second time.
    again = [srflow, "render", "--out", one, "--shard", f"{pairs}/{pairs}", *options]
    run(again, folder / "one-first")
    opening = [srflow, "eval", "--method", "farneback", "--split", "all", "--limit", 1, "--dataset"]
    steps = [
        ("a part again", again),
        ("merge", [srflow, "merge", *parts, "--out", whole]),
        ("open the folder", [*opening, f"srflow:{whole}"]),
        ("check --hashes", [srflow, "check", "--hashes", whole]),
        ("pack", [srflow, "pack", whole, "--out", packed]),
        ("open wds:", [*opening, f"wds:{packed}"]),
        ("check", [srflow, "check", whole, "--json"]),
    ]
    for name, command in steps:
        seconds, megabytes = run(command, folder / name.replace(" ", "-").strip(":-"))
        print(f"| {name} | {pairs:,} | {files:,} | {seconds:.2f} | {1e6 * seconds / files:.2f} | {megabytes:.0f} |", flush=True)
        if name == "merge":
            for part in parts:
                shutil.rmtree(part)
    shutil.rmtree(folder)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("srflow", type=Path, help="the binary")
    parser.add_argument("folder", type=Path, help="a new folder")
    parser.add_argument("--pairs", type=int, nargs="+", default=[10**3, 10**4, 10**5, 10**6], help=f"multiples of {FRAMES}")
    parser.add_argument("--parts", type=int, default=100)
    parser.add_argument("--size", default="48x48", help="of the frames")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    if any(pairs < FRAMES or pairs % FRAMES for pairs in args.pairs):
        parser.error(f"--pairs: expected multiples of {FRAMES}, found {args.pairs}")
    args.folder.mkdir(parents=True)
    srflow, base = args.srflow.resolve(), args.folder / "scene"
    seconds, _ = run([srflow, "render", "--out", base, *arguments(1, args.size, args.seed)], args.folder / "render")
    print(f"a scene of {FRAMES} pairs rendered in {seconds:.0f} s", file=sys.stderr)
    print("| step | pairs | files | seconds | µs a file | peak MB |")
    print("|---|---|---|---|---|---|")
    for pairs in args.pairs:
        measure(srflow, args.folder / str(pairs), base / "train", pairs, args.parts, args.size, args.seed)
    shutil.rmtree(args.folder)


if __name__ == "__main__":
    main()
