"""Makes a dataset in parts with Ray, and merges them.

    pip install ray
    python ray_parts.py --parts 4 --out srflow -- --scenes 2 --frames 6 --size 110x160

Each part is a task of one core; a task whose machine is lost is run again and continues. The folder is one that all machines of the Ray cluster
share; without a cluster, Ray starts one on this machine.
"""

import argparse
import subprocess

import ray


# 75: stopped by a signal, to be continued.
@ray.remote(num_cpus=1, max_retries=5, retry_exceptions=[InterruptedError])
def make(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode == 75:
        raise InterruptedError(done.stderr)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr}")
    return done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", type=int, default=4)
    parser.add_argument("--out", required=True)
    parser.add_argument("--srflow", default="srflow", help="the binary")
    parser.add_argument("arguments", nargs="*", help="arguments of `srflow render`")
    args = parser.parse_args()
    ray.init(ignore_reinit_error=True)
    folders = [f"{args.out}-part-{number}" for number in range(1, args.parts + 1)]
    tasks = [
        make.remote([args.srflow, "render", *args.arguments, "--threads", "1", "--shard", f"{number}/{args.parts}", "--out", folder])
        for number, folder in enumerate(folders, 1)
    ]
    for report in ray.get(tasks):
        print(report.splitlines()[0])
    subprocess.run([args.srflow, "merge", *folders, "--out", args.out], check=True)


if __name__ == "__main__":
    main()
