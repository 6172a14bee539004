#!/usr/bin/env python3
"""Small files with the structure of FLAME's, as Python 2, Python 3 and NumPy write them, and the vertices that FLAME's equations
give for them in float64.

Writes crates/head/tests/data/flame/. Needs numpy and scipy:

    tools/golden/flame.py

Made with numpy 2.4.6 and scipy 1.17.1. The numbers are random; no file of FLAME is needed or read. chumpy is not needed either: a
class of its name is pickled.
"""

import io
import json
import pickle
import struct
import sys
import types
from pathlib import Path

import numpy as np
import scipy.sparse

DATA = Path(__file__).resolve().parents[2] / "crates/head/tests/data/flame"
VERTICES, SHAPES, EXPRESSIONS, JOINTS = 8, 300, 3, 5
PARENTS = [0xFFFFFFFF, 0, 1, 1, 1]

chumpy = types.ModuleType("chumpy")
chumpy.ch = types.ModuleType("chumpy.ch")
sys.modules |= {"chumpy": chumpy, "chumpy.ch": chumpy.ch}


class Ch:
    """As chumpy.ch.Ch is pickled: its attributes."""

    def __init__(self, x):
        self.x = x
        self._itr = None


Ch.__module__, Ch.__qualname__ = "chumpy.ch", "Ch"
chumpy.ch.Ch = Ch


class Python2(pickle._Pickler):
    """Writes strings and names of modules as Python 2 does."""

    dispatch = dict(pickle._Pickler.dispatch)
    MODULES = {
        "numpy._core.multiarray": "numpy.core.multiarray",
        "scipy.sparse._csc": "scipy.sparse.csc",
        "copyreg": "copy_reg",
        "builtins": "__builtin__",
    }

    def save_string(self, text):
        data = text.encode() if isinstance(text, str) else text
        if self.proto == 0:
            escaped = "".join(chr(b) if 32 <= b < 127 and chr(b) not in "\\'" else f"\\x{b:02x}" for b in data)
            self.write(f"S'{escaped}'\n".encode())
        elif len(data) < 256:
            self.write(b"U" + bytes([len(data)]) + data)
        else:
            self.write(b"T" + struct.pack("<I", len(data)) + data)
        self.memoize(text)

    dispatch[bytes] = dispatch[str] = save_string

    def save_global(self, obj, name=None):
        module = pickle.whichmodule(obj, obj.__name__)
        self.write(f"c{self.MODULES.get(module, module)}\n{obj.__name__}\n".encode())
        self.memoize(obj)

    dispatch[types.FunctionType] = dispatch[types.BuiltinFunctionType] = dispatch[type] = save_global


def python2(value, protocol):
    out = io.BytesIO()
    Python2(out, protocol).dump(value)
    return out.getvalue()


def model():
    random = np.random.default_rng(1)
    normal = lambda *shape: random.normal(0, 1, shape).astype(np.float32).astype(np.float64)
    regressor = np.zeros((JOINTS, VERTICES))
    for joint in range(JOINTS):
        at = random.choice(VERTICES, 3, replace=False)
        regressor[joint, at] = np.float32([0.5, 0.25, 0.25])
    weights = random.dirichlet(np.ones(JOINTS), VERTICES)
    weights[5:, :], weights[5, 3], weights[6, 4], weights[7, 4] = 0, 1, 1, 1
    return {
        "v_template": 0.1 * normal(VERTICES, 3),
        "shapedirs": 0.004 * normal(VERTICES, 3, SHAPES + EXPRESSIONS),
        "posedirs": 0.01 * normal(VERTICES, 3, 36),
        "J_regressor": regressor,
        "kintree_table": np.array([PARENTS, range(JOINTS)], np.uint32),
        "weights": weights,
        "f": np.array([[v, (v + 1) % VERTICES, (v + 2) % VERTICES] for v in range(VERTICES)], np.uint32),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


def rodrigues(vector):
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def vertices(flame, p):
    """Equations 1 to 4 of SMPL (Loper et al. 2015) with expressions, in the order of FLAME's lbs.py."""
    components = np.concatenate([np.pad(p["shape"], (0, SHAPES - len(p["shape"]))), p["expr"]])
    shaped = flame["v_template"] + flame["shapedirs"] @ components
    shaped += np.array(p["static_offset"]) + np.array(p["dynamic_offset"])
    joints = flame["J_regressor"] @ shaped
    eyes = p["eyes_pose"]
    turns = [rodrigues(np.array(r)) for r in (p["rotation"], p["neck_pose"], p["jaw_pose"], eyes[:3], eyes[3:])]
    features = np.concatenate([(turn - np.eye(3)).ravel() for turn in turns[1:]])
    posed = shaped + flame["posedirs"] @ features
    world = []
    for joint, turn in enumerate(turns):
        local = np.eye(4)
        parent = PARENTS[joint] if joint else None
        local[:3, :3] = turn
        local[:3, 3] = joints[joint] - (0 if parent is None else joints[parent])
        world.append(local if parent is None else world[parent] @ local)
    for joint, matrix in enumerate(world):
        matrix[:3, 3] -= matrix[:3, :3] @ joints[joint]
    blended = np.einsum("vj,jab->vab", flame["weights"], np.array(world))
    skinned = np.einsum("vab,vb->va", blended[:, :3, :3], posed) + blended[:, :3, 3]
    return skinned + np.array(p["translation"])


def main():
    DATA.mkdir(parents=True, exist_ok=True)
    flame = model()
    dense = {name: value for name, value in flame.items() if not isinstance(value, str)}
    sparse = flame | {"J_regressor": scipy.sparse.csc_matrix(flame["J_regressor"])}
    single = {
        name: value.astype(np.float32) if getattr(value, "dtype", None) == np.float64 else value
        for name, value in flame.items()
    }
    single["J_regressor"] = scipy.sparse.csc_matrix(single["J_regressor"])
    wrapped = sparse | {"v_template": Ch(flame["v_template"]), "shapedirs": Ch(flame["shapedirs"])}
    wrapped["posedirs"] = Ch(np.asfortranarray(flame["posedirs"]))
    (DATA / "python2.pkl").write_bytes(python2(wrapped, 2))
    text = single | {"v_template": Ch(single["v_template"])}
    (DATA / "python2-text.pkl").write_bytes(python2(text, 0))
    (DATA / "python3-protocol2.pkl").write_bytes(pickle.dumps(single, 2))
    (DATA / "python3-protocol5.pkl").write_bytes(pickle.dumps(single, 5))
    np.savez_compressed(DATA / "arrays.npz", **dense)

    masks = {"lips": np.array([3, 1]), "left_eyeball": np.array([5]), "right_eyeball": np.array([7, 6])}
    (DATA / "FLAME_masks.pkl").write_bytes(python2(masks, 2))
    random = np.random.default_rng(2)
    bary = random.dirichlet(np.ones(3), 70)
    embedding = {
        "full_lmk_faces_idx": random.integers(0, VERTICES, (1, 70)),
        "full_lmk_bary_coords": bary[None],
        "dynamic_lmk_faces_idx": [np.arange(17)] * 3,
    }
    np.save(DATA / "landmark_embedding_with_eyes.npy", embedding, allow_pickle=True)

    rows = lambda *shape: random.normal(0, 1, shape).astype(np.float32).astype(np.float64)
    parameters = {
        "shape": rows(300),
        "expr": rows(EXPRESSIONS),
        "rotation": 0.4 * rows(3),
        "neck_pose": 0.2 * rows(3),
        "jaw_pose": 0.2 * rows(3),
        "eyes_pose": 0.3 * rows(6),
        "translation": 0.1 * rows(3),
        "static_offset": 0.002 * rows(VERTICES, 3),
        "dynamic_offset": 0.001 * rows(VERTICES, 3),
    }
    parameters = {name: value.astype(np.float32).tolist() for name, value in parameters.items()}
    posed = vertices(flame, parameters)
    corners = posed[flame["f"].astype(int)[embedding["full_lmk_faces_idx"][0]]]
    landmarks = np.einsum("lc,lca->la", bary, corners)
    expected = {"vertices": posed.tolist(), "landmarks": landmarks.tolist()}
    (DATA / "parameters.json").write_text(json.dumps(parameters))
    (DATA / "expected.json").write_text(json.dumps(expected))
    # Timestep 0 at rest, and timestep 1 with these parameters, in the shapes of VHAP.
    timesteps = {name: np.array(value, np.float32) for name, value in parameters.items()}
    for name in timesteps.keys() - {"shape", "static_offset"}:
        timesteps[name] = np.stack([np.zeros_like(timesteps[name]), timesteps[name]])
    timesteps["static_offset"] = timesteps["static_offset"][None]
    np.savez_compressed(DATA / "parameters.npz", **timesteps)


main()
