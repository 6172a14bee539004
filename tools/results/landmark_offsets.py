#!/usr/bin/env python3
"""Where MediaPipe puts dlib's landmarks on rendered heads: crates/avatar/src/fit/detectors/mediapipe.rs.

    python tools/results/landmark_offsets.py HEAD NAME SCRATCH > table

HEAD is a head of `srflow avatar capture`, such as builtin or ict:FaceXModel, and NAME that of the table. Needs srflow on the path,
SRFLOW_FACE_MODELS, and numpy. Each head is seen by cameras from the left to the right. An offset is the three-dimensional vector, in
the axes of the head, that explains best how far the detected landmark is from the true one in all pictures.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

PERSONS = range(101, 125)
CAMERAS = range(2, 15)
WIDTH, HEIGHT = 640, 360
TIMESTEPS = 24
# Heads that are turned further from the camera are left out, degrees.
FARTHEST = 35


def capture(head: str, seed: int, folder: Path) -> None:
    """Renders a person, and detects the landmarks of each camera."""
    if (folder / "done").exists():
        return
    options = ["--cameras", "16", "--timesteps", str(TIMESTEPS), "--size", f"{WIDTH}x{HEIGHT}", "--noise", "1"]
    options += ["--background", "#707880", "--force"]
    command = ["srflow", "avatar", "capture", "--head", head, "--seed", str(seed), "--out", str(folder)]
    subprocess.run(command + options, check=True, capture_output=True)
    for camera in CAMERAS:
        pictures = [str(folder / f"images/{timestep:05}_{camera:02}.png") for timestep in range(TIMESTEPS)]
        command = ["srflow", "face", *pictures, "--force", "--out", str(folder / f"detected-{camera:02}.csv")]
        subprocess.run(command, check=True, capture_output=True)
    (folder / "done").touch()


def rotation(vector: np.ndarray) -> np.ndarray:
    """The matrix of a rotation vector."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / max(angle, 1e-12)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def offsets(folder: Path) -> np.ndarray:
    """From true to detected landmarks (68, 3), in distances between the outer corners of the eyes."""
    cameras = {}
    for frame in json.loads((folder / "transforms.json").read_text())["frames"]:
        world_from_camera = np.array(frame["transform_matrix"]) @ np.diag([1, -1, -1, 1])
        cameras[frame["camera_index"]] = np.linalg.inv(world_from_camera), frame["fl_x"]
    true = {}
    for row in csv.DictReader((folder / "landmarks.csv").open()):
        face = true.setdefault((int(row["timestep"]), int(row["camera"])), np.full((68, 2), np.nan))
        face[int(row["landmark"])] = float(row["x"]), float(row["y"])
    heads = {}
    for timestep in range(TIMESTEPS):
        pose = np.load(folder / f"flame_param/{timestep:05}.npz")
        turned = rotation(pose["rotation"][0].astype(float)) @ rotation(pose["neck_pose"][0].astype(float))
        heads[timestep] = turned, pose["translation"][0].astype(float)

    on_head = true_places(cameras, true, heads[0])
    normal, right = np.zeros((68, 3, 3)), np.zeros((68, 3))
    for camera in CAMERAS:
        camera_from_world, focal = cameras[camera]
        for row in csv.DictReader((folder / f"detected-{camera:02}.csv").open()):
            if row["success"] != "1":
                continue
            timestep = int(row["frame"])
            world_from_head, place = heads[timestep]
            camera_from_head = camera_from_world[:3, :3] @ world_from_head
            if -camera_from_head[2, 2] < np.cos(np.radians(FARTHEST)):
                continue
            in_camera = camera_from_world[:3, :3] @ (world_from_head @ on_head.T + place[:, None])
            depths = in_camera[2] + camera_from_world[2, 3]
            pixels_from_head = focal / depths[:, None, None] * camera_from_head[:2]
            detected = np.array([[float(row[f"x_{n}"]), float(row[f"y_{n}"])] for n in range(68)])
            apart = detected - true.get((timestep, camera), np.nan)
            seen = np.isfinite(apart).all(axis=1)
            normal[seen] += np.einsum("lpi,lpj->lij", pixels_from_head, pixels_from_head)[seen]
            right[seen] += np.einsum("lpi,lp->li", pixels_from_head, apart)[seen]
    metres = np.linalg.solve(normal, right[..., None])[..., 0]
    return metres / np.linalg.norm(on_head[36] - on_head[45])


def true_places(cameras: dict, true: dict, head: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """The true landmarks in the axes of the head at the first timestep (68, 3), metres."""
    world_from_head, place = head
    places = np.zeros((68, 3))
    for landmark in range(68):
        rows, values = [], []
        for camera, (camera_from_world, focal) in cameras.items():
            across = (true[0, camera][landmark] - [WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5]) / focal
            for axis in (0, 1):
                rows.append(camera_from_world[axis, :3] - across[axis] * camera_from_world[2, :3])
                values.append(across[axis] * camera_from_world[2, 3] - camera_from_world[axis, 3])
        world = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
        places[landmark] = world_from_head.T @ (world - place)
    return places


def main() -> None:
    head, name, scratch = sys.argv[1:]
    persons = []
    for seed in PERSONS:
        folder = Path(scratch) / f"{name.lower()}-{seed}"
        capture(head, seed, folder)
        persons.append(offsets(folder))
    numbers = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    print("#[rustfmt::skip]")
    print(f"pub(super) const {name}: [[[f64; 3]; 2]; LANDMARK_COUNT] = [")
    for mean, deviation in zip(np.mean(persons, axis=0), np.std(persons, axis=0, ddof=1)):
        print(f"    [{numbers(mean)}, {numbers(deviation)}],")
    print("];")


if __name__ == "__main__":
    main()
