"""Checks a capture, and optionally the files of an avatar, as GaussianAvatars and VHAP read them.

    python tools/parity/captures.py CAPTURE [AVATAR]

The steps follow those programs' loaders, without their code or dependencies: GaussianAvatars `scene/dataset_readers.py`
(`readDynamicNerfInfo`), `scene/__init__.py`, `scene/flame_gaussian_model.py` (`load_meshes`, `load_ply`) and
`scene/gaussian_model.py` (`load_ply`); VHAP `vhap/data/nerf_dataset.py`. Needs numpy and OpenCV.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

FLAME = {"translation": 3, "rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6}


def cameras(folder: Path, split: str):
    """`readCamerasFromTransforms`: rotation, translation and symmetric field of view of every picture."""
    contents = json.loads((folder / f"transforms_{split}.json").read_text())
    found = []
    for frame in contents["frames"]:
        path = frame["file_path"] if ".png" in frame["file_path"] else frame["file_path"] + ".png"
        c2w = np.array(frame["transform_matrix"])
        c2w[:3, 1:3] *= -1
        w2c = np.linalg.inv(c2w)
        assert np.allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3), atol=1e-9) and np.linalg.det(w2c[:3, :3]) > 0
        focal = frame["w"] / (2 * np.tan(frame["camera_angle_x"] / 2))
        assert abs(focal - frame["fl_x"]) < 1e-6 and abs(frame["fl_x"] - frame["fl_y"]) < 1e-6
        assert "camera_id" in frame and isinstance(frame["camera_index"], int)
        found.append((folder / path, w2c, focal, frame))
    return contents, found


def meshes(folder: Path, frames):
    """`readMeshesFromTransforms` and `load_meshes`: one file for each timestep, in arrays of all."""
    loaded = {}
    for *_, frame in frames:
        if frame["timestep_index"] not in loaded:
            loaded[frame["timestep_index"]] = dict(np.load(folder / frame["flame_param_path"], allow_pickle=False))
    count = max(loaded) + 1
    first = next(iter(loaded.values()))
    assert first["static_offset"].ndim == 3 and first["static_offset"].shape[0] == 1 and first["static_offset"].shape[2] == 3
    assert first["shape"].ndim == 1
    all_expr = np.zeros((count, first["expr"].shape[1]), np.float32)
    for timestep, mesh in loaded.items():
        all_expr[timestep] = mesh["expr"][0]
        for name, columns in FLAME.items():
            assert mesh[name].shape == (1, columns) and mesh[name].dtype == np.float32, (name, mesh[name].shape)
        assert np.array_equal(mesh["shape"], first["shape"])
    return count, loaded


def pixels(path: Path, frame, folder: Path):
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image.shape == (frame["h"], frame["w"], 3) and image.dtype == np.uint8, image.shape
    mask = cv2.imread(str(folder / frame["fg_mask_path"]), cv2.IMREAD_UNCHANGED)
    assert mask.shape == (frame["h"], frame["w"]) and mask.dtype == np.uint8, mask.shape
    behind = image[mask == 0]
    assert len(behind) and (behind.max(axis=0) - behind.min(axis=0) <= 1).all(), "one background where the mask is 0"
    return (mask > 127).mean()


def capture(folder: Path):
    assert (folder / "canonical_flame_param.npz").exists(), "GaussianAvatars takes it for another kind of scene"
    canonical = np.load(folder / "canonical_flame_param.npz")
    assert np.allclose(canonical["jaw_pose"], [[0.3, 0, 0]])
    splits = {split: cameras(folder, split) for split in ["train", "val", "test"]}
    whole = json.loads((folder / "transforms.json").read_text())
    # `NeRFDataset` of VHAP
    assert len(whole["timestep_indices"]) == max(whole["timestep_indices"]) + 1
    train_steps = splits["train"][0]["timestep_indices"]
    assert len(train_steps) == int(np.ceil(len(whole["timestep_indices"]) * 0.7))
    assert sum(len(frames) for _, frames in splits.values()) == len(whole["frames"])
    frames = [frame for _, frames in splits.values() for frame in frames]
    count, loaded = meshes(folder, frames)
    means = np.mean([mesh["translation"][0] for mesh in loaded.values()], axis=0)
    assert np.abs(means).max() < 1e-5, "the head is at the origin of the world"
    shares = [pixels(path, frame, folder) for path, _, _, frame in frames]
    centres = np.array([-w2c[:3, :3].T @ w2c[:3, 3] for _, w2c, _, _ in splits["train"][1]])
    extent = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max() * 1.1
    sizes = {name: len(frames) for name, (_, frames) in splits.items()}
    print(f"{folder}: {count} timesteps, pictures {sizes}, extent {extent:.3f} m, heads cover {np.mean(shares):.1%}")


def avatar(folder: Path):
    data = (folder / "point_cloud.ply").read_bytes()
    header, body = data.split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    values = np.frombuffer(body, np.float32).reshape(-1, len(names))
    assert len(names) == 63 and len([name for name in names if name.startswith("f_rest_")]) == 45
    assert [name for name in names if name.startswith("scale_")] == ["scale_0", "scale_1", "scale_2"]
    assert [name for name in names if name.startswith("rot")] == ["rot_0", "rot_1", "rot_2", "rot_3"]
    binding = values[:, names.index("binding_0")].astype(np.int32)
    parameters = np.load(folder / "flame_param.npz", allow_pickle=False)
    timesteps, vertices = parameters["expr"].shape[0], parameters["static_offset"].shape[1]
    assert all(array.dtype == np.float32 for array in parameters.values()), "torch.from_numpy takes every array"
    for name, columns in FLAME.items():
        assert parameters[name].shape == (timesteps, columns), name
    assert parameters["dynamic_offset"].shape == (timesteps, vertices, 3) and parameters["static_offset"].shape[0] == 1
    assert np.isfinite(values).all() and binding.min() >= 0
    print(f"{folder}: {len(values)} Gaussians on triangles up to {binding.max()}, {timesteps} timesteps, {vertices} vertices")


if __name__ == "__main__":
    capture(Path(sys.argv[1]))
    for folder in sys.argv[2:]:
        avatar(Path(folder))
