"""Results of the benchmarks over time: `--record` appends them to history/TOPIC.csv."""

import csv
import datetime
import os
import sys
from pathlib import Path

FOLDER = Path(__file__).parent / "history"


# Processes that wait for a processor, on average over a minute: more than this measures scheduling.
MOST_LOAD = 0.5


def parse(parser):
    """Parses the arguments, and refuses to measure on a busy machine."""
    parser.add_argument("--record", action="store_true", help="append the results to tools/bench/history")
    parser.add_argument("--busy", action="store_true", help=f"measure although the load is above {MOST_LOAD}")
    args = parser.parse_args()
    # The benchmarks run themselves again with these options, which is their own load.
    is_part = any(getattr(args, option, None) for option in ("side", "weights"))
    if hasattr(os, "getloadavg") and not is_part:
        load = os.getloadavg()[0]
        print(f"load before the start: {load:.2f}", file=sys.stderr)
        if load > MOST_LOAD and not args.busy:
            sys.exit(f"error: the load is above {MOST_LOAD}; wait until the machine is idle, or give --busy")
    return args


def append(topic, ours, peer, note):
    """Appends a row: the seconds of both programs (`peer` may be None) and what was measured."""
    ratio = f"{peer / ours:.2f}" if peer else ""
    command = " ".join(["python3", "tools/bench/" + Path(sys.argv[0]).name, *sys.argv[1:]])
    seconds = [f"{ours:.3f}", f"{peer:.3f}" if peer else ""]
    row = [datetime.date.today().isoformat(), machine(), command, *seconds, ratio, note]
    with open(FOLDER / f"{topic}.csv", "a", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(row)


def machine():
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(": ", 1)[1] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration, IndexError):
        model = "unknown processor"
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{cores} cores of {model}{load}"
