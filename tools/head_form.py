"""Fits the form of the built-in head to ICT-FaceKit and writes crates/head/src/builtin/form.txt.

    SRFLOW_WRITE_AVERAGE_HALF=half.json cargo test --release -p srflow-head --lib the_average_half
    python tools/head_form.py FaceXModel half.json crates/head/src/builtin/form.txt

FaceXModel is the folder of https://github.com/ICT-VGL/ICT-FaceKit (MIT). The script reads its neutral head, identities and expressions.
The result is a smooth displacement of the sculpted head: sums of Gaussian kernels on its surface, one set of coefficients
for the average face, one for each of the most frequent ways in which faces differ, and one for each action unit.

Needs numpy and scipy.
"""

import json
import pathlib
import sys

import numpy as np
from scipy.spatial import cKDTree

# Vertices of ICT-FaceKit's face, head and neck; the rest is inside mouth and eyes, eyeballs, teeth and lashes.
SKIN = 11248
MODES = 10
# Action units in terms of ICT-FaceKit's expressions, as in crates/head/src/arkit.rs; both halves together.
UNITS = {
    1: ["browInnerUp_L", "browInnerUp_R"],
    2: ["browOuterUp_L", "browOuterUp_R"],
    4: ["browDown_L", "browDown_R"],
    # Both at once raise cheeks by 13 mm.
    6: ["cheekRaiser_L", "cheekRaiser_R", "cheekSquint_L", "cheekSquint_R"],
    9: ["noseSneer_L", "noseSneer_R"],
    10: ["mouthUpperUp_L", "mouthUpperUp_R"],
    12: ["mouthSmile_L", "mouthSmile_R"],
    14: ["mouthDimple_L", "mouthDimple_R"],
    15: ["mouthFrown_L", "mouthFrown_R"],
    16: ["mouthLowerDown_L", "mouthLowerDown_R"],
    17: ["mouthShrugLower"],
    20: ["mouthStretch_L", "mouthStretch_R"],
    24: ["mouthPress_L", "mouthPress_R"],
}


def obj(path):
    """Vertices in millimetres and polygons of a Wavefront file, whose unit is the centimetre."""
    vertices, polygons = [], []
    for line in path.read_text().splitlines():
        if line.startswith("v "):
            vertices.append([float(number) for number in line.split()[1:4]])
        elif line.startswith("f "):
            polygons.append([int(corner.split("/")[0]) - 1 for corner in line.split()[1:]])
    return np.array(vertices) * 10.0, polygons


def triangles_of(polygons):
    return np.array([[p[0], p[i], p[i + 1]] for p in polygons for i in range(1, len(p) - 1)])


def normals_of(vertices, triangles):
    normals = np.zeros_like(vertices)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    for i in range(3):
        np.add.at(normals, triangles[:, i], np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def smoothstep(low, high, x):
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * t * (t * (t * 6 - 15) + 10)


def chart(points, mouth):
    """Places of vertices in which upper and lower lip are apart: what `Chart` of form.rs computes."""
    along = np.minimum(points[:, 0] / 25.0, 1.0)
    apart = 7.0 * (1 - along * along) * (1 - smoothstep(4.0, 14.0, np.abs(mouth)))
    return points + np.stack([0 * apart, np.sign(mouth) * apart, 0 * apart], axis=1)


def kernels(points, centres, widths):
    squares = ((points[:, None] - centres[None]) ** 2).sum(2)
    return np.exp(-squares / (2 * widths[None] ** 2))


class Basis:
    """Symmetric fields: each kernel comes with its mirror image."""

    def __init__(self, points, centres, widths):
        here, there = kernels(points, centres, widths), kernels(points * [-1, 1, 1], centres, widths)
        self.across, self.along = here - there, here + there

    def field(self, coefficients):
        return np.stack(
            [self.across @ coefficients[:, 0], self.along @ coefficients[:, 1], self.along @ coefficients[:, 2]], axis=1
        )

    def fit(self, targets, weights, ridge):
        """Least squares towards displacements of all points."""
        result = np.zeros((self.along.shape[1], 3))
        for axis, matrix in enumerate([self.across, self.along, self.along]):
            left = matrix.T @ (matrix * weights[:, None]) + ridge * np.eye(matrix.shape[1])
            result[:, axis] = np.linalg.solve(left, matrix.T @ (targets[:, axis] * weights))
        return result


def main():
    folder, half_path, out = (pathlib.Path(argument) for argument in sys.argv[1:4])
    half = json.loads(half_path.read_text())
    points = np.array([vertex[0] for vertex in half["vertices"]])
    parts = [vertex[1].split()[0] for vertex in half["vertices"]]
    mouth = np.array([vertex[2] for vertex in half["vertices"]])
    triangles = np.array(half["triangles"])
    is_skin = np.array([part == "Skin" for part in parts])
    normals = normals_of(points, triangles)

    neutral, polygons = obj(folder / "generic_neutral_mesh.obj")
    indices = json.loads((folder / "vertex_indices.json").read_text())
    landmarks = neutral[np.array(indices["idx_to_landmark_verts"])]
    # The eyeballs of ICT-FaceKit, and ours.
    ball = neutral[21451:23021]
    eye = ball.min(0) * 0.5 + ball.max(0) * 0.5
    eye[0] = abs(eye[0])
    our_eye = np.array([31.5, 28.0, 69.5])
    shift = our_eye - eye
    shift[0] = 0.0
    neutral, landmarks = neutral + shift, landmarks + shift
    skin_triangles = triangles_of([polygon for polygon in polygons if max(polygon) < SKIN])
    target_normals = normals_of(neutral, skin_triangles)[:SKIN]
    target = neutral[:SKIN]
    # Both halves onto the left one.
    cloud = np.concatenate([target, target * [-1, 1, 1]])
    cloud_normals = np.concatenate([target_normals, target_normals * [-1, 1, 1]])
    source = np.concatenate([np.arange(SKIN), np.arange(SKIN)])
    flip = np.concatenate([np.ones(SKIN), -np.ones(SKIN)])
    tree = cKDTree(cloud)

    # Kernels: denser where the face has features.
    skin = np.flatnonzero(is_skin & (points[:, 1] > -112))
    x, y, z = points[skin].T
    spacing = np.where((x < 34) & (y > -64) & (y < 50) & (z > 72), 6.5, np.where((z > 20) & (y > -112), 12.0, 26.0))
    places = chart(points, mouth)
    chosen = []
    far = np.full(len(skin), np.inf)
    at = int(np.argmin(np.abs(x) + np.abs(y + 43)))
    while True:
        chosen.append(skin[at])
        far = np.minimum(far, np.linalg.norm(places[skin] - places[skin[at]], axis=1) / spacing)
        at = int(np.argmax(far))
        if far[at] < 1.0:
            break
    chosen = np.array(chosen)
    widths = np.array([spacing[np.flatnonzero(skin == vertex)[0]] for vertex in chosen]) * 1.15
    centres, charted = np.round(points[chosen], 1), np.round(places[chosen], 1)
    widths = np.round(widths, 1)
    print(len(chosen), "kernels")

    plain = Basis(points, centres, widths)
    opened = Basis(places, charted, widths)

    # The average face: closest points, from stiff to soft. Around the eyes everything moves as the eyeball does: not at all.
    near_eye = np.linalg.norm(points - our_eye, axis=1)
    anchored = near_eye < 19
    neck = smoothstep(-118, -95, points[:, 1])
    back = smoothstep(-30, 0, points[:, 2])
    free = is_skin & (neck > 0)
    weights = np.where(is_skin, neck * back, 0.0)
    weights[~free] = 0
    # Landmarks: nose, lips, and the brows' and the chin's height are the same places in both.
    ours_at = np.array(half["landmarks"])
    pairs = [8] + list(range(27, 36)) + list(range(48, 68))
    nearest = [int(np.flatnonzero(free)[np.argmin(np.linalg.norm(points[free] - np.abs(ours_at[i]) * [1, np.sign(ours_at[i][1]), 1], axis=1))]) for i in pairs]
    wanted = landmarks[pairs] * np.where(landmarks[pairs][:, :1] < 0, [[-1, 1, 1]], [[1, 1, 1]])

    field = np.zeros_like(points)
    coefficients = np.zeros((len(centres), 3))
    for round_number, ridge in enumerate([30, 30, 10, 10, 3, 3, 1, 1, 0.5, 0.5, 0.3, 0.3]):
        moved = points + field
        turned = normals_of(moved, triangles)
        distances, indices = tree.query(moved, k=12)
        agree = np.einsum("vkc,vc->vk", cloud_normals[indices], turned)
        cost = distances + 12 * (1 - agree)
        best = indices[np.arange(len(points)), np.argmin(cost, axis=1)]
        off = cloud[best] - moved
        normal = cloud_normals[best]
        along = np.einsum("vc,vc->v", off, normal)[:, None] * normal
        # Along the surface points may slide.
        goal = field + along + 0.15 * (off - along)
        fits = (np.einsum("vc,vc->v", normal, turned) > 0.5) & (np.linalg.norm(off, axis=1) < 18)
        weight = np.where(fits, weights, 0.0)
        # Anchors.
        weight[anchored] = 4.0
        goal[anchored] = 0.0
        weight[is_skin & (points[:, 1] < -118)] = 0.5
        goal[is_skin & (points[:, 1] < -118)] = 0.0
        behind = is_skin & (points[:, 2] < -30)
        weight[behind], goal[behind] = 0.2, 0.0
        goal[nearest], weight[nearest] = wanted - points[nearest], 60.0
        coefficients = plain.fit(goal, weight, ridge)
        field = plain.field(coefficients)
        face = free & (points[:, 2] > 20) & ~anchored & fits
        print(f"round {round_number}: {np.abs(along[face]).mean():.2f} mm from the surface, moved {np.linalg.norm(field[face], axis=1).mean():.2f}")

    sections = [("average", coefficients)]

    # What each vertex of ours corresponds to: four near vertices of theirs.
    moved = points + field
    distances, indices = tree.query(moved, k=4)
    inverse = 1 / np.maximum(distances, 0.3) ** 2
    shares = inverse / inverse.sum(1, keepdims=True)
    def carried(displacement):
        both = displacement[source] * np.stack([flip, np.ones_like(flip), np.ones_like(flip)], axis=1)
        return np.einsum("vk,vkc->vc", shares, both[indices])

    jaw, _ = obj(folder / "jawOpen.obj")
    lips = np.tile(lips_of((jaw + shift - neutral)[:SKIN]), 2)

    def carried_lips(displacement):
        """As `carried`, with upper and lower lip from their own sides."""
        result = carried(displacement)
        both = displacement[source] * np.stack([flip, np.ones_like(flip), np.ones_like(flip)], axis=1)
        for sign in (1, -1):
            mine = np.flatnonzero(is_skin & (np.sign(mouth) == sign) & (np.abs(mouth) < 16) & (points[:, 0] < 26))
            side = np.flatnonzero(lips == sign)
            near = cKDTree(cloud[side])
            d, i = near.query(moved[mine], k=4)
            w = 1 / np.maximum(d, 0.3) ** 2
            w /= w.sum(1, keepdims=True)
            result[mine] = np.einsum("vk,vkc->vc", w, both[side[i]])
        return result

    # Ways in which faces differ: principal components of the identities, as fields of ours.
    identities = []
    for path in sorted(folder.glob("identity*.obj")):
        vertices, _ = obj(path)
        identities.append(vertices + shift - neutral)
    fields = []
    for offset in identities:
        eyes_move = offset[21451:23021].mean(0)
        eyes_move[0] = 0.0
        wanted_field = carried(offset[:SKIN] - eyes_move)
        weight = np.where(free, weights, 0.0)
        weight[anchored] = 2.0
        wanted_field[anchored] = 0.0
        low = is_skin & (points[:, 1] < -118)
        weight[low], wanted_field[low] = 0.5, 0.0
        fields.append(plain.fit(wanted_field, weight, 3.0))
    stack = np.array([plain.field(f)[free & (points[:, 2] > 0)].ravel() for f in fields])
    u, s, _ = np.linalg.svd(stack, full_matrices=False)
    share = s**2 / (s**2).sum()
    print("identities: shares of the variance", np.round(share[: MODES + 2], 3), "sum", share[:MODES].sum())
    for mode in range(MODES):
        sections.append(("identity", np.einsum("i,icx->cx", u[:, mode], np.array(fields))))

    # Action units.
    for unit, names in UNITS.items():
        displacement = np.zeros((SKIN, 3))
        for name in names:
            vertices, _ = obj(folder / f"{name}.obj")
            displacement += (vertices + shift - neutral)[:SKIN] * (0.5 if unit == 6 else 1.0)
        wanted_field = carried_lips(displacement)
        weight = np.where(free, weights, 0.0)
        low = is_skin & (points[:, 1] < -118)
        weight[low], wanted_field[low] = 0.5, 0.0
        lids = near_eye < 14.5
        weight[lids], wanted_field[lids] = 0.3, 0.0
        fit = opened.fit(wanted_field, weight, 0.3)
        got = opened.field(fit)
        moving = free & (np.linalg.norm(wanted_field, axis=1) > 1.0)
        error = np.linalg.norm(got - wanted_field, axis=1)[moving]
        print(f"unit {unit}: moves {np.linalg.norm(wanted_field, axis=1).max():.1f} mm at most, off by {error.mean():.2f} mm")
        sections.append((f"unit {unit}", fit))

    text = ["# Written by tools/head_form.py. Kernels: place, place with the lips apart (tenths of mm), width (tenths of mm)."]
    for centre, place, width in zip(centres, charted, widths):
        text.append(" ".join(str(round(10 * number)) for number in [*centre, *place, width]))
    for name, coefficients in sections:
        rows = np.round(coefficients * 100).astype(int)
        text.append(f"{name}  # kernel, displacement (hundredths of mm)")
        least = 2 if name.startswith("unit") else 1
        for number, row in enumerate(rows):
            if np.abs(row).max() >= least:
                text.append(" ".join(map(str, [number, *row])))
    out.write_text("\n".join(text) + "\n")
    print(out, out.stat().st_size, "bytes")


def lips_of(opened):
    """1 for vertices that stay as the jaw opens, -1 for those that move, by the displacements when it does."""
    moved = np.linalg.norm(opened, axis=1)
    return np.where(moved < 0.42 * moved.max(), 1, -1)


if __name__ == "__main__":
    main()
