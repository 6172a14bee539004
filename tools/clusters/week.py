"""A week of a cluster in minutes: makes a dataset in 1000 parts while processes are killed and disks fill, merges the parts, and compares every
byte with the dataset that one process makes.

    cargo build --release
    python3 tools/clusters/week.py target/release/srflow FOLDER

A third of the processes get SIGTERM or SIGKILL at a random moment and are requeued; so do two of the processes that merge. One part in ten is made
in a folder that all of these share; one in twenty is given to two processes at the same time; one in fifty is on a disk that is too small until
an operator makes it larger (a tmpfs, which needs root and Linux; without, this is skipped, and the table says so). A second dataset, of heads, is
made the same way in fewer parts. What is killed, and which part is where, follows from --seed; the moments follow from the machine, too.

FOLDER must be new. Ends with 1 and says what is wrong if a file is lost, differs, or is there that should not be, or if a process ends in any
other way than expected; then FOLDER stays for a look.
"""

import argparse
import collections
import concurrent.futures
import filecmp
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

STOPPED = 75  # the exit code after SIGTERM: run the command again
KILLED = 1 / 3  # share of the processes
ATTEMPTS = 50  # of a part, before it counts as lost


class Week:
    """One dataset that is made in parts."""

    def __init__(self, srflow, folder, command, parts, jobs, seed):
        self.srflow, self.folder, self.command, self.parts, self.seed = srflow, folder, command, parts, seed
        self.jobs = jobs
        self.counts = collections.Counter()
        self.durations = []  # of processes that ended by themselves
        self.lock = threading.Lock()
        self.disk = folder / "disk"
        self.disk_size = 96 << 10 if parts >= 50 else 0  # less than one part needs
        folder.mkdir()

    def fail(self, what):
        raise SystemExit(f"{self.folder}: {what}")

    def folder_of(self, part):
        if part % 50 == 7 and self.disk_size:
            return self.disk / f"part-{part:04}"
        return self.folder / ("shared" if part % 10 == 3 else f"part-{part:04}")

    def start(self, arguments):
        return subprocess.Popen(
            [str(word) for word in (self.srflow, *arguments)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def end(self, processes, chance):
        """Waits for processes that were started together, or kills them on the way. Returns their exit codes and what they said."""
        began = time.monotonic()
        fates = [chance.choice([signal.SIGTERM, signal.SIGKILL]) if chance.random() < KILLED else None for _ in processes]
        moments = [chance.random() for _ in processes]
        with self.lock:
            usual = statistics.median(self.durations[-50:]) if self.durations else 0.1
        order = sorted(zip(moments, fates, processes), key=lambda item: item[0])
        for moment, fate, process in order:
            if fate is None:
                continue
            try:
                process.wait(max(0, began + moment * usual - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.send_signal(fate)
        ended = [(process.communicate()[0], process.returncode) for process in processes]
        with self.lock:
            for fate, (said, code) in zip(fates, ended):
                self.counts["processes"] += 1
                if code == STOPPED or code == -signal.SIGTERM and fate == signal.SIGTERM:
                    # Without 75 the signal came before the program watched for it.
                    self.counts["ended by SIGTERM"] += 1
                elif code == -signal.SIGKILL and fate == signal.SIGKILL:
                    self.counts["ended by SIGKILL"] += 1
                elif code == 0 and fate is None:
                    self.durations.append(time.monotonic() - began)
        return ended

    def attempt(self, part, number):
        """Runs a part once. Returns whether it is complete."""
        chance = random.Random(f"{self.seed} {part} {number}")
        arguments = [*self.command, "--shard", f"{part}/{self.parts}", "--threads", 1, "--out", self.folder_of(part)]
        twins = 2 if part % 20 == 1 else 1
        with self.lock:
            self.counts["given twice"] += twins - 1 if number == 0 else 0
        ended = self.end([self.start(arguments) for _ in range(twins)], chance)
        for said, code in ended:
            if code == 1 and "No space left on device" in said:
                if "free some space" not in said:
                    self.fail(f"part {part}: a full disk, without what to do: {said}")
                self.enlarge()
            elif code not in (0, STOPPED, -signal.SIGTERM, -signal.SIGKILL):
                self.fail(f"part {part} ended with {code}, expected 0 or {STOPPED}: {said}")
        return any(code == 0 for _, code in ended)

    def enlarge(self):
        with self.lock:
            self.counts["full disks"] += 1
            self.disk_size *= 2
            subprocess.run(["mount", "-o", f"remount,size={self.disk_size}", self.disk], check=True)

    def make(self, part):
        for number in range(ATTEMPTS):
            if self.attempt(part, number):
                with self.lock:
                    self.counts["requeued"] += number
                return
        self.fail(f"part {part} is not complete after {ATTEMPTS} attempts")

    def make_all(self):
        if self.disk_size:
            self.disk.mkdir()
            mounted = subprocess.run(
                ["mount", "-t", "tmpfs", "-o", f"size={self.disk_size}", "tmpfs", self.disk], capture_output=True, text=True
            )
            if mounted.returncode != 0:
                self.disk_size = 0
                print(f"no disk that fills: {mounted.stderr.strip()}", file=sys.stderr)
        with concurrent.futures.ThreadPoolExecutor(self.jobs) as pool:
            order = list(range(1, self.parts + 1))
            random.Random(self.seed).shuffle(order)
            for done, _ in enumerate(pool.map(self.make, order), 1):
                if done % 100 == 0:
                    print(f"{done} of {self.parts} parts", file=sys.stderr)

    def merge(self):
        """Merges the parts, and returns the seconds of all processes; the first ones are killed on the way."""
        began = time.monotonic()
        folders = sorted({self.folder_of(part) for part in range(1, self.parts + 1)})
        merge = ["merge", *folders, "--out", self.folder / "merged"]
        for fate in (signal.SIGTERM, signal.SIGKILL):
            process = self.start(merge)
            deadline = time.monotonic() + 60
            # In the middle of the links of one, while the other writes the hashes.
            seen = "data" if fate == signal.SIGTERM else ".SHA256SUMS*"
            while process.poll() is None and time.monotonic() < deadline and not any((self.folder / "merged").glob(seen)):
                time.sleep(0.001)
            process.send_signal(fate)
            said = process.communicate()[0]
            if process.returncode not in (0, STOPPED, -fate):
                self.fail(f"merging ended with {process.returncode} after {fate.name}: {said}")
            self.counts["killed merges"] += process.returncode != 0
        self.succeed(merge)
        return time.monotonic() - began

    def succeed(self, arguments):
        process = self.start(arguments)
        said = process.communicate()[0]
        if process.returncode != 0:
            self.fail(f"{' '.join(map(str, arguments[:2]))} ended with {process.returncode}, expected 0: {said[-2000:]}")
        return said

    def compare(self):
        """The number of files and bytes of the merged dataset, which are those of the one that one process made."""
        one, merged = self.folder / "one", self.folder / "merged"
        expected, found = names(one), names(merged)
        if expected != found:
            lost, more = sorted(expected - found), sorted(found - expected)
            self.fail(f"{len(lost)} files are lost, such as {lost[:3]}; {len(more)} are too many, such as {more[:3]}")
        differing = [name for name in sorted(expected) if not filecmp.cmp(one / name, merged / name, shallow=False)]
        if differing:
            self.fail(f"{len(differing)} files have other bytes, such as {differing[:3]}")
        return len(expected), sum((one / name).stat().st_size for name in expected)

    def pass_by(self):
        """Makes the dataset both ways. Returns the row of the table."""
        try:
            print(f"{self.folder.name}: one process", file=sys.stderr)
            began = time.monotonic()
            self.succeed([*self.command, "--threads", self.jobs, "--out", self.folder / "one"])
            alone = time.monotonic() - began
            began = time.monotonic()
            self.make_all()
            in_parts = time.monotonic() - began
            merged = self.merge()
            for dataset in ("one", "merged"):
                self.succeed(["check", "--hashes", self.folder / dataset])
            files, size = self.compare()
        finally:
            if self.disk.is_mount():
                subprocess.run(["umount", self.disk], check=False)
        counts = self.counts
        disks = counts["full disks"] if self.disk_size else "skipped"
        return (
            f"| {self.folder.name} | {self.parts} | {counts['given twice']} | {counts['processes']} | {counts['ended by SIGTERM']} | {counts['ended by SIGKILL']} "
            f"| {counts['requeued']} | {disks} | {counts['killed merges']} | {files:,} files, {size / 1e6:.1f} MB | {alone:.0f} s "
            f"| {in_parts:.0f} s | {merged:.1f} s |"
        )


def names(folder):
    """All files below a folder, hidden ones too."""
    return {str(Path(at, name).relative_to(folder)) for at, _, files in os.walk(folder) for name in files}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("srflow", type=Path, help="the binary")
    parser.add_argument("folder", type=Path, help="a new folder")
    parser.add_argument("--parts", type=int, default=1000, help="of the dataset of generic pairs, 8 pairs each")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at a time")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.folder.mkdir(parents=True)
    srflow, folder = args.srflow.resolve(), args.folder.resolve()
    shapes = ["shapes", "--pairs", 8 * args.parts, "--size", "16x16", "--seed", args.seed]
    heads = ["render", "--scenes", 3, "--frames", 8, "--size", "32x32", "--seed", args.seed]
    rows = [
        Week(srflow, folder / "shapes", shapes, args.parts, args.jobs, args.seed).pass_by(),
        Week(srflow, folder / "render", heads, 12, args.jobs, args.seed).pass_by(),
    ]
    print(
        "| command | parts | given twice | processes | ended by SIGTERM | by SIGKILL | requeued | full disks | killed merges | same bytes in | one process "
        "| all parts | merge |"
    )
    print("|---" * 13 + "|")
    print("\n".join(rows))
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()
