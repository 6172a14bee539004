"""How good a method is on faces: test sets of pairs, scores by region, strain, lattice and expression, with intervals.

    pip install numpy opencv-python-headless
    python tools/results/face_network.py sets DIR [--look 1] [--heads NAME=HEAD...] [--faces PHOTOGRAPH...] [--photographs PHOTOGRAPH...]
    python tools/results/face_network.py score DIR NAME -- --method srflow --iters 2
    python tools/results/face_network.py table DIR NAME... [--score head]
    python tools/results/face_network.py change DIR --before NAME... --after NAME... [--score head]

`sets` renders heads with seeds that no training uses, and warps photographs by known flows; `score` runs `srflow eval` with the options
after `--` on each set; `table` prints the mean of a score over the pairs of a set, with 95 % intervals by bootstrap over scenes;
`change` how much it changes on the same pairs, averaged over trainings that are paired by seed. The
program is `srflow`, or the one that SRFLOW names.

Scores: `all`, `head`, `skin`, `eyes`, `mouth`, `hair`, `neck`, `background`: end-point error in pixels; `small`: that of pixels that move
less than half a pixel; `strain_error`, `strain_correlation`: inside the head, against the strain of the true flow; `lattice`: root of
the power of the flow's differences at the Nyquist frequency over that of its middle band; `expression`: correlation with the true motion
of the expression, once an affine motion that most of the head follows is subtracted; `seconds`.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import warped_photographs

PROGRAM = os.environ.get("SRFLOW", "srflow")
REGIONS = ("skin", "eyes", "mouth", "hair", "neck")
RENDERED = {
    "wild": ["--preset", "wild", "--scenes", "8", "--frames", "3", "--size", "550x802", "--seed", "77001"],
    "plain": ["--scenes", "6", "--frames", "3", "--size", "550x802", "--seed", "77002"],
    "wild-large": ["--preset", "wild", "--scenes", "4", "--frames", "2", "--size", "1100x1604", "--seed", "77003"],
}
HEADS = ["--preset", "wild", "--scenes", "5", "--frames", "3", "--size", "550x802", "--seed", "77004"]
WEAK = {
    "weak-192": ["--side", "192", "--subjects", "8", "--clips", "3", "--seed", "77010"],
    "weak-512": ["--side", "512", "--subjects", "4", "--clips", "3", "--seed", "77011"],
}
# Whole pixels by which the camera moves at most along each axis.
CAMERA_PX = 3
# Side of the windows and rows in which the lattice is looked for.
WINDOW = 32


def run(*command):
    done = subprocess.run([PROGRAM, *command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{PROGRAM} {' '.join(command)}:\n{done.stderr}")
    return done.stdout


def read_flo(path):
    data = Path(path).read_bytes()
    width, height = np.frombuffer(data[4:12], "<i4")
    return np.frombuffer(data[12:], "<f4").reshape(height, width, 2)


def put(folder, name, frames, flow, region, expression=None):
    """A pair of a plain folder, with its region map (0 is the background) beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    warped_photographs.write_pair(folder, name, frames, flow)
    np.savez_compressed(folder / f"{name}.npz", region=region, **({} if expression is None else {"expression": expression}))


def rendered(out, made, name, options):
    """The pairs of a dataset; of `wild` also still pairs and a moving camera."""
    run("render", "--out", str(made / name), "--splits", "0,0,1", "--regions", "--flow-format", "flo", *options)
    rng = np.random.default_rng(5)
    part = made / name / "test"
    for path in sorted(part.glob("flow/*/*.flo")):
        scene, number = path.parent.name, int(path.stem)
        frames = [cv2.imread(str(part / "frames" / scene / f"{number + k:05d}.png")) for k in (0, 1)]
        gray = lambda kind: cv2.imread(str(part / kind / scene / f"{number:05d}.png"), cv2.IMREAD_GRAYSCALE)
        region = np.where(gray("mask") > 0, np.maximum(gray("regions"), 1), 0)
        flow = read_flo(path)
        put(out / name, f"{scene}-{number}", frames, flow, region)
        if name != "wild" or number > 1:
            continue
        if number == 0:
            noisy = np.clip(np.rint(frames[0] + rng.normal(0, 1.5, frames[0].shape)), 0, 255).astype(np.uint8)
            put(out / "still", f"{scene}-noise", [frames[0], noisy], np.zeros_like(flow), region)
            put(out / "still", f"{scene}-same", [frames[0]] * 2, np.zeros_like(flow), region)
        else:
            moved = rng.integers(-CAMERA_PX, CAMERA_PX + 1, 2)
            height, width = region.shape
            inside = lambda x, y: (slice(8 + y, height - 8 + y), slice(8 + x, width - 8 + x))
            first, second = frames[0][inside(0, 0)], frames[1][inside(*moved)]
            put(out / "camera", f"{scene}-moved", [first, second], flow[inside(0, 0)] - moved, region[inside(0, 0)])


def weak(out, made, name, options):
    folder = made / name
    run("mer", "synth", "--out", str(folder), "--only-key-frames", "--intensity", "0.25", *options)
    for row in csv.DictReader(open(folder / "clips.csv")):
        clip = row["clip"]
        frames = [cv2.imread(str(folder / clip / f"{int(row[key]):04d}.png")) for key in ("onset", "apex")]
        mask = cv2.imread(str(folder / f"{clip}_mask.png"), cv2.IMREAD_GRAYSCALE) > 0
        flows = [read_flo(folder / f"{clip}_{kind}.flo") for kind in ("flow", "expression_flow")]
        put(out / name, clip.replace("/", "-"), frames, flows[0], mask.astype(np.uint8), flows[1])


def warped(folder, paths, drift_px, bumps_px, pairs):
    warped_photographs.DRIFT_PX, warped_photographs.BUMPS_PX = drift_px, bumps_px
    warped_photographs.MARGIN = max(12, int(2 * drift_px[1]))
    for path in paths:
        photograph = cv2.imread(str(path)).astype(np.float32)
        for number in range(pairs):
            rng = np.random.default_rng([7, number, *Path(path).name.encode(), *folder.name.encode()])
            first, second, flow = warped_photographs.pair(rng, photograph)
            if np.linalg.norm(flow, axis=-1).mean() < 2 * drift_px[1]:
                put(folder, f"{Path(path).stem}-{number}", [first, second], flow, np.ones(flow.shape[:2], np.uint8))


def sets(args):
    out, made = args.dir / "sets", args.dir / "made"
    look = ["--look", args.look] if args.look else []
    for name, options in RENDERED.items():
        rendered(out, made, name, [*options, *look])
    for name, head in (named.split("=", 1) for named in args.heads):
        rendered(out, made, name, ["--head", head, *HEADS, *look])
    for name, options in WEAK.items():
        weak(out, made, name, [*options, *look])
    for name, paths in (("faces", args.faces), ("photographs", args.photographs)):
        warped(out / name, paths, (0.05, 4.0), (0.1, 3.0), 3)
        warped(out / f"{name}-fast", paths, (8.0, 25.0), (1.0, 6.0), 2)


def strain(flow):
    """The magnitude of the strain tensor of each pixel."""
    (xy, xx), (yy, yx) = np.gradient(flow[..., 0]), np.gradient(flow[..., 1])
    return np.sqrt(xx**2 + yy**2 + 0.5 * (xy + yx) ** 2)


def lattice(flow, inside):
    change, spectra = np.diff(flow, axis=1), []
    height, width = inside.shape
    for y in range(0, height - WINDOW, WINDOW // 2):
        for x in range(0, width - WINDOW - 1, WINDOW // 2):
            if inside[y : y + WINDOW, x : x + WINDOW + 1].all():
                rows = change[y : y + WINDOW, x : x + WINDOW] * np.hanning(WINDOW)[None, :, None]
                spectra.append((np.abs(np.fft.rfft(rows, axis=1)) ** 2).mean((0, 2)))
    if not spectra:
        return np.nan
    power = np.mean(spectra, 0)
    return np.sqrt(power[-1] / power[len(power) // 3 : len(power) * 3 // 4].mean())


def without_head(flow, head):
    """`flow` on the head without the affine motion that most of it follows."""
    y, x = np.nonzero(head)
    terms = np.stack([np.ones(len(x)), x - x.mean(), y - y.mean()], 1)
    flow, weight = flow[head], np.ones(len(x))
    for _ in range(5):
        solution = np.linalg.lstsq(terms * weight[:, None], flow * weight[:, None], rcond=None)[0]
        rest = flow - terms @ solution
        weight = 1 / (1 + (np.linalg.norm(rest, axis=1) / 0.1) ** 2)
    return rest


def scores_of(flow, truth, stored):
    region, known = stored["region"], np.abs(truth).max(-1) < 1e9
    error = np.linalg.norm(flow - truth, axis=-1)
    head = (region > 0) & known
    inside = cv2.erode(np.pad(head, 1).astype(np.uint8), np.ones((5, 5), np.uint8))[1:-1, 1:-1] > 0
    mean = lambda mask: error[mask].mean() if mask.sum() > 50 else np.nan
    own, true = strain(flow)[inside], strain(truth)[inside]
    found = {
        "all": mean(known),
        "head": mean(head),
        "background": mean(known & ~head),
        "small": mean(head & (np.linalg.norm(truth, axis=-1) < 0.5)),
        "strain_error": np.abs(own - true).mean(),
        "strain_correlation": np.corrcoef(own, true)[0, 1] if true.std() > 1e-6 else np.nan,
        "lattice": lattice(flow, inside),
    }
    if region.max() > 1:
        found |= {name: mean((region == number) & known) for number, name in enumerate(REGIONS, 1)}
    if "expression" in stored:
        own, true = without_head(flow, head), stored["expression"][head]
        found["expression"] = (own * true).sum() / np.sqrt((own**2).sum() * (true**2).sum())
    return found


def score(args):
    for folder in sorted((args.dir / "sets").iterdir()):
        flows = args.dir / "flows"
        shutil.rmtree(flows, ignore_errors=True)
        options = ["--dataset", f"folder:{folder}", "--json", "--save-flow", str(flows), *args.options]
        methods = json.loads(run("eval", *options))["methods"]
        own = next(method for method in methods if not method["baseline"])
        rows = {}
        for pair in own["pairs"]:
            name = Path(pair["pair"]).name
            (path,) = (path for path in flows.rglob("*.flo") if path.stem == name)
            found = scores_of(read_flo(path), read_flo(folder / f"{name}_flow.flo"), np.load(folder / f"{name}.npz"))
            rows[name] = {key: float(value) for key, value in found.items()} | {"seconds": pair["seconds"]}
        (args.dir / "scores" / args.name).mkdir(parents=True, exist_ok=True)
        (args.dir / "scores" / args.name / f"{folder.name}.json").write_text(json.dumps(rows))
    shutil.rmtree(flows, ignore_errors=True)


def interval(values, scenes, rng):
    """95 % of the means of samples of scenes, with repetition."""
    of_scene = [values[scenes == scene] for scene in np.unique(scenes)]
    draw = lambda: np.concatenate([of_scene[i] for i in rng.integers(0, len(of_scene), len(of_scene))]).mean()
    return np.percentile([draw() for _ in range(2000)], [2.5, 97.5])


def table(args):
    read = lambda name: {path.stem: json.loads(path.read_text()) for path in sorted((args.dir / "scores" / name).glob("*.json"))}
    found = {name: read(name) for name in args.names}
    print(f"| {args.score} | " + " | ".join(args.names) + " |\n|---|" + "--:|" * len(args.names))
    for kind in sorted(set.union(*(set(scores) for scores in found.values()))):
        cells = []
        for scores in found.values():
            rows = {pair: row.get(args.score) for pair, row in scores.get(kind, {}).items()}
            rows = {pair: value for pair, value in rows.items() if value is not None and not np.isnan(value)}
            values, scenes = np.array(list(rows.values())), np.array([pair.rsplit("-", 1)[0] for pair in rows])
            if not len(values):
                cells.append("")
                continue
            low, high = interval(values, scenes, np.random.default_rng(1))
            cells.append(f"{values.mean():.3f} ({low:.3f} to {high:.3f})")
        if any(cells):
            print(f"| {kind} | " + " | ".join(cells) + " |")


def change(args):
    print(f"| {args.score} | before | change | by training |\n|---|--:|--:|---|")
    read = lambda name, kind: json.loads((args.dir / "scores" / name / kind).read_text())
    for kind in sorted(path.name for path in (args.dir / "scores" / args.before[0]).glob("*.json")):
        found = [[read(name, kind) for name in names] for names in (args.before, args.after)]
        pairs = list(found[0][0])
        before, after = (np.array([[rows[pair].get(args.score, np.nan) for pair in pairs] for rows in side]) for side in found)
        known = ~np.isnan(before + after).any(0)
        if not known.any():
            continue
        each = (after - before)[:, known]
        scenes = np.array([pair.rsplit("-", 1)[0] for pair in pairs])[known]
        low, high = interval(each.mean(0), scenes, np.random.default_rng(1))
        seeds = ", ".join(f"{mean:+.3f}" for mean in each.mean(1))
        print(f"| {kind[:-5]} | {before[:, known].mean():.3f} | {each.mean():+.3f} ({low:+.3f} to {high:+.3f}) | {seeds} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    for does in (sets, score, table, change):
        command = commands.add_parser(does.__name__)
        command.set_defaults(does=does)
        command.add_argument("dir", type=Path)
        if does is sets:
            command.add_argument("--look", help="of the heads, as for `srflow render`")
            command.add_argument("--heads", nargs="*", default=[], help="more heads, such as ict=ict:FACEXMODEL with identities that no training saw")
            command.add_argument("--faces", type=Path, nargs="*", default=[])
            command.add_argument("--photographs", type=Path, nargs="*", default=[])
        if does is score:
            command.add_argument("name")
            command.add_argument("options", nargs=argparse.REMAINDER)
        if does is table:
            command.add_argument("names", nargs="+")
        if does is change:
            command.add_argument("--before", nargs="+", required=True)
            command.add_argument("--after", nargs="+", required=True)
        if does in (table, change):
            command.add_argument("--score", default="head")
    args = parser.parse_args()
    if "options" in args and args.options[:1] == ["--"]:
        args.options = args.options[1:]
    args.does(args)


if __name__ == "__main__":
    main()
