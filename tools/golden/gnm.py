#!/usr/bin/env python3
"""A small file with the structure of gnm_head.npz (google/GNM, version 3), and the vertices and landmarks that the equations of
gnm_common.py give for it in float64.

Writes crates/head/tests/data/gnm/. Needs numpy:

    tools/golden/gnm.py

Made with numpy 2.4.6. The numbers are random; no file of GNM is needed or read.
"""

import json
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[2] / "crates/head/tests/data/gnm"
NAMES = ["neck", "head", "left_eye", "right_eye"]
PARENTS = [0, 0, 1, 1]
VERTICES, IDENTITIES, EXPRESSIONS = 28, 4, 5


def rodrigues(vector):
    angle = max(np.linalg.norm(vector), 1e-4)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def vertices(gnm, identity, expression, rotations, translation):
    points = gnm["template_vertex_positions"].astype(np.float64)
    points = points + np.tensordot(identity, gnm["vertex_identity_basis"], 1)
    points = points + np.tensordot(expression, gnm["expression_basis"], 1)
    joints = gnm["template_joint_positions"] + np.tensordot(identity, gnm["joint_identity_basis"], 1)
    turns = np.array([rodrigues(rotation) for rotation in rotations])
    features = (turns - np.eye(3)).ravel()
    points = points + (features @ gnm["pose_correctives_regressor"]).reshape(-1, 3)
    world = []
    for joint, turn in enumerate(turns):
        local = np.eye(4)
        local[:3, :3] = turn
        local[:3, 3] = joints[joint] + translation if joint == 0 else joints[joint] - joints[PARENTS[joint]]
        world.append(local if joint == 0 else world[PARENTS[joint]] @ local)
    turned = np.array([matrix[:3, :3] for matrix in world])
    moved = np.array([matrix[:3, 3] - matrix[:3, :3] @ joint for matrix, joint in zip(world, joints)])
    blended = np.einsum("jv,jab->vab", gnm["skinning_weights"].astype(np.float64), turned)
    return np.einsum("vab,vb->va", blended, points) + np.einsum("jv,ja->va", gnm["skinning_weights"], moved)


def main():
    DATA.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(4)
    normal = lambda size, *shape: random.normal(0, size, shape).astype(np.float32)
    template = normal(0.1, VERTICES, 3)
    # Vertices 0 to 16 are the jaw, from ear to ear.
    around = np.linspace(-1.5, 1.5, 17)
    template[:17] = np.stack([0.1 * np.sin(around), -0.1 * np.cos(around), 0.05 * np.cos(around)], 1)
    quads = np.array([[v, v + 1, v + 3, v + 2] for v in range(0, VERTICES - 3, 2)], np.int32)
    weights = random.dirichlet(np.ones(4), VERTICES).T.astype(np.float32)
    groups = {
        "left_eye": [17, 18], "right_eye": [19, 20], "upper_lip": [0, 1, 2, 3], "lower_lip": [], "tongue": [26, 27],
    }
    members = np.zeros((len(groups), VERTICES), np.float32)
    for row, group in zip(members, groups.values()):
        row[group] = 0.5
    members[0, 5] = 5e-5  # below the threshold
    identity_basis = normal(0.01, IDENTITIES, VERTICES, 3)
    identity_basis[1, 3:] = 0
    correctives = normal(0.01, 36, 3 * VERTICES)
    correctives[9:18] = 0
    gnm = {
        "version": np.array("3.0"),
        "variant": np.array("head"),
        "template_vertex_positions": template,
        "template_joint_positions": normal(0.05, 4, 3),
        "vertex_identity_basis": identity_basis,
        "joint_identity_basis": normal(0.01, IDENTITIES, 4, 3),
        "expression_basis": normal(0.01, EXPRESSIONS, VERTICES, 3),
        "identity_names": np.array([f"head_{i}" for i in range(IDENTITIES)]),
        "joint_names": np.array(NAMES),
        "expression_names": np.array([f"lower_face_region_{i}" for i in range(EXPRESSIONS)]),
        "joint_parent_indices": np.array(PARENTS, np.int32),
        "skinning_weights": weights,
        "quads": quads,
        "triangles": np.concatenate([quads[:, :3], quads[:, [2, 3, 0]]]),
        "pose_correctives_regressor": correctives,
        "vertex_groups": members,
        "vertex_group_names": np.array(list(groups)),
    }
    np.savez_compressed(DATA / "gnm_head.npz", **gnm)

    # The jaw's landmarks are its vertices, the others random points of triangles; rows 2 to 6 are stored backwards.
    corners = gnm["triangles"][random.integers(0, len(gnm["triangles"]), 68)]
    bary = np.round(random.dirichlet(np.ones(3), 68), 3)
    bary[:, 2] = np.round(1 - bary[:, 0] - bary[:, 1], 3)
    for landmark in range(17):
        holder = gnm["triangles"][np.any(gnm["triangles"] == landmark, 1)][0]
        corners[landmark] = np.roll(holder, -list(holder).index(landmark))
        bary[landmark] = [1, 0, 0]
    stored = np.arange(68)
    stored[2:7] = stored[2:7][::-1]
    rows = [" ".join(f"{v} {w:.3f}" for v, w in zip(corners[i], bary[i])) for i in stored]
    (DATA / "head_sparse_68.txt").write_text("\n".join(rows) + "\n")

    identity, expression = normal(1, IDENTITIES), normal(1, EXPRESSIONS)
    rotations, translation = normal(0.4, 4, 3), normal(0.1, 3)
    parameters = {
        "shape": identity, "expr": expression, "rotation": rotations[0], "neck_pose": rotations[1],
        "eyes_pose": rotations[2:].ravel(), "translation": translation,
    }
    (DATA / "parameters.json").write_text(json.dumps({name: value.tolist() for name, value in parameters.items()}))
    posed = vertices(gnm, identity.astype(float), expression.astype(float), rotations.astype(float), translation)
    landmarks = np.einsum("lc,lca->la", bary, posed[corners])
    (DATA / "expected.json").write_text(json.dumps({"vertices": posed.tolist(), "landmarks": landmarks.tolist()}))


main()
