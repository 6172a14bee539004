// How a head moves: the definition is `srflow_avatar::HeadModel`. Quaternions are [x, y, z, w].

function multiplied([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

/** The rotation by an axis times an angle in radians. */
function ofAxisAngle(turn) {
  const angle = Math.hypot(...turn);
  if (angle === 0) return [0, 0, 0, 1];
  const factor = Math.sin(angle / 2) / angle;
  return [...turn.map((x) => x * factor), Math.cos(angle / 2)];
}

/** A turn to the subject's left, up, and about the gaze, in radians. */
function turned(yaw, pitch, roll) {
  return multiplied(multiplied(ofAxisAngle([0, yaw, 0]), ofAxisAngle([-pitch, 0, 0])), ofAxisAngle([0, 0, roll]));
}

/** Rows of a rotation matrix. */
function matrixOf([x, y, z, w]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
  ];
}

function matrixProduct(a, b) {
  const out = new Array(9);
  for (let row = 0; row < 9; row += 3) {
    for (let column = 0; column < 3; column++) {
      out[row + column] = a[row] * b[column] + a[row + 1] * b[3 + column] + a[row + 2] * b[6 + column];
    }
  }
  return out;
}

function transformed(matrix, [x, y, z]) {
  return [0, 3, 6].map((row) => matrix[row] * x + matrix[row + 1] * y + matrix[row + 2] * z);
}

/** Displacements of some vertices for each of several shapes. */
class Shapes {
  constructor(arrays, name) {
    this.starts = arrays[`${name}_starts`];
    this.vertices = arrays[`${name}_vertices`];
    this.offsets = singles(arrays[`${name}_offsets`]);
  }

  add(shape, weight, positions) {
    for (let i = this.starts[shape]; i < this.starts[shape + 1]; i++) {
      const vertex = 3 * this.vertices[i];
      for (let axis = 0; axis < 3; axis++) positions[vertex + axis] += weight * this.offsets[3 * i + axis];
    }
  }
}

class Head {
  /** From a pack's `head` and its arrays. */
  constructor(facts, arrays) {
    Object.assign(this, facts); // joints, units, joints_follow_expressions, expressions_are_components, correctives
    this.shaped = arrays.vertices;
    this.triangles = arrays.triangles;
    this.expressions = new Shapes(arrays, "expression");
    this.arcs = new Shapes(arrays, "arc");
    this.corrections = new Shapes(arrays, "correction");
    this.skin = { starts: arrays.skin_starts, joints: arrays.skin_joints, weights: arrays.skin_weights };
    this.motion = { expressions: arrays.motion_expressions, joints: arrays.motion_joints, translations: arrays.motion_translations };
    this.offsets = arrays.motion_offsets ? singles(arrays.motion_offsets) : null;
    this.timesteps = this.motion.translations.length / 3;
    this.expressionCount = this.expressions.starts.length - 1;
    this.vertices = new Float32Array(this.shaped.length);
  }

  restPose() {
    return {
      expressions: new Float32Array(this.expressionCount),
      joints: this.joints.map(() => [0, 0, 0, 1]),
      translation: [0, 0, 0],
      offset: null,
    };
  }

  /** The pose of the motion at a timestep. */
  poseAt(timestep) {
    const [e, j] = [this.expressionCount, this.joints.length];
    const joint = (number) => Array.from(this.motion.joints.subarray(4 * (timestep * j + number), 4 * (timestep * j + number + 1)));
    const vertices = this.shaped.length;
    return {
      expressions: this.motion.expressions.slice(timestep * e, (timestep + 1) * e),
      joints: this.joints.map((_, number) => joint(number)),
      translation: Array.from(this.motion.translations.subarray(3 * timestep, 3 * timestep + 3)),
      offset: this.offsets?.subarray(timestep * vertices, (timestep + 1) * vertices) ?? null,
    };
  }

  /** The pose with action units added: `intensities` are those of `units`, 0 to 1. */
  withUnits(pose, intensities) {
    const sums = new Float32Array(this.expressionCount);
    const full = new Float32Array(this.expressionCount);
    const turns = this.joints.map(() => [0, 0, 0]);
    const used = new Map(); // units of components that are one by two numbers count once
    this.units.forEach((unit, number) => {
      if (!intensities[number]) return;
      const key = this.expressions_are_components ? JSON.stringify([unit.expressions, unit.joints]) : number;
      const before = used.get(key);
      used.set(key, { unit, intensity: Math.max(intensities[number], before?.intensity ?? 0) });
    });
    for (const { unit, intensity } of used.values()) {
      for (const [expression, weight] of unit.expressions) {
        sums[expression] += weight * intensity;
        if (Math.abs(weight) > Math.abs(full[expression])) full[expression] = weight;
      }
      for (const [joint, turn] of unit.joints) turn.forEach((x, axis) => (turns[joint][axis] += x * intensity));
    }
    const expressions = pose.expressions.map((weight, i) => {
      const limited = Math.min(Math.max(sums[i], Math.min(full[i], 0)), Math.max(full[i], 0));
      return weight + (this.expressions_are_components ? sums[i] : limited);
    });
    const joints = pose.joints.map((joint, number) => multiplied(joint, ofAxisAngle(turns[number])));
    return { ...pose, expressions, joints };
  }

  /** The pose with the joint of this role turned further, if there is one. */
  withTurn(pose, role, rotation) {
    const joints = pose.joints.map((joint, i) => (this.joints[i].role === role ? multiplied(joint, rotation) : joint));
    return { ...pose, joints };
  }

  hasJoint(role) {
    return this.joints.some((joint) => joint.role === role);
  }

  /** Writes the frames of the triangles in this pose into `frames`: origin, scale and rotation, 8 numbers each. */
  pose(pose, frames) {
    const vertices = this.vertices;
    vertices.set(this.shaped);
    pose.expressions.forEach((weight, i) => {
      if (weight === 0) return;
      this.expressions.add(i, weight, vertices);
      if (weight > 0 && weight < 1) this.arcs.add(i, 4 * weight * (1 - weight), vertices);
    });
    if (pose.offset) for (let i = 0; i < vertices.length; i++) vertices[i] += pose.offset[i];
    const rest = this.joints.map((joint) => this.restOf(joint));
    this.correctives.forEach((joint, number) => {
      matrixOf(pose.joints[joint]).forEach((entry, i) => {
        const weight = entry - (i % 4 === 0 ? 1 : 0);
        if (weight !== 0) this.corrections.add(9 * number + i, weight, vertices);
      });
    });
    this.followJoints(rest, pose);
    this.framesInto(frames);
  }

  /** Rest position of a joint of the head with an expression. */
  restOf(joint) {
    if (!this.joints_follow_expressions) return joint.position;
    return joint.position.map((x, axis) => {
      const moved = ([vertex, weight]) => weight * (this.vertices[3 * vertex + axis] - this.shaped[3 * vertex + axis]);
      return joint.follows.reduce((sum, follow) => sum + moved(follow), x);
    });
  }

  followJoints(rest, pose) {
    const transforms = [];
    this.joints.forEach((joint, number) => {
      const parent = joint.parent === null ? { rotation: matrixOf([0, 0, 0, 1]), translation: pose.translation } : transforms[joint.parent];
      const rotation = matrixProduct(parent.rotation, matrixOf(pose.joints[number]));
      const position = transformed(parent.rotation, rest[number]);
      const back = transformed(rotation, rest[number]);
      transforms.push({ rotation, translation: position.map((x, axis) => x + parent.translation[axis] - back[axis]) });
    });
    const flat = transforms.map(({ rotation: r, translation: t }) => [r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2]]);
    const { starts, joints, weights } = this.skin;
    const sum = new Float64Array(12);
    for (let vertex = 0; vertex + 1 < starts.length; vertex++) {
      sum.fill(0);
      for (let i = starts[vertex]; i < starts[vertex + 1]; i++) {
        const transform = flat[joints[i]];
        for (let k = 0; k < 12; k++) sum[k] += weights[i] * transform[k];
      }
      const at = 3 * vertex;
      const [x, y, z] = [this.vertices[at], this.vertices[at + 1], this.vertices[at + 2]];
      this.vertices[at] = sum[0] * x + sum[1] * y + sum[2] * z + sum[3];
      this.vertices[at + 1] = sum[4] * x + sum[5] * y + sum[6] * z + sum[7];
      this.vertices[at + 2] = sum[8] * x + sum[9] * y + sum[10] * z + sum[11];
    }
  }

  /** The local frames of the triangles in GaussianAvatars (Qian et al. 2024): `srflow_avatar::TriangleFrame`. */
  framesInto(frames) {
    const { vertices: v, triangles } = this;
    for (let t = 0, f = 0; t < triangles.length; t += 3, f += 8) {
      const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
      const e1 = [v[b] - v[a], v[b + 1] - v[a + 1], v[b + 2] - v[a + 2]];
      const e2 = [v[c] - v[a], v[c + 1] - v[a + 1], v[c + 2] - v[a + 2]];
      const base = Math.hypot(...e1);
      const a0 = base > 0 ? e1.map((x) => x / base) : [1, 0, 0];
      let a1 = cross(a0, e2);
      const length = Math.hypot(...a1);
      a1 = length > 0 ? a1.map((x) => x / length) : anyOrthogonal(a0);
      const a2 = cross(a0, a1);
      for (let axis = 0; axis < 3; axis++) frames[f + axis] = (v[a + axis] + v[b + axis] + v[c + axis]) / 3;
      frames[f + 3] = (base + Math.abs(a2[0] * e2[0] + a2[1] * e2[1] + a2[2] * e2[2])) / 2;
      rotationInto(a0, a1, a2, frames, f + 4);
    }
  }
}

function cross([ax, ay, az], [bx, by, bz]) {
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
}

function anyOrthogonal([x, y, z]) {
  const other = Math.abs(x) < 0.5 ? [1, 0, 0] : [0, 1, 0];
  const found = cross([x, y, z], other);
  const length = Math.hypot(...found);
  return found.map((k) => k / length);
}

/** The quaternion of the matrix with these columns. */
function rotationInto([m00, m10, m20], [m01, m11, m21], [m02, m12, m22], out, at) {
  let q;
  if (m00 + m11 + m22 > 0) q = [m21 - m12, m02 - m20, m10 - m01, 1 + m00 + m11 + m22];
  else if (m00 > m11 && m00 > m22) q = [1 + m00 - m11 - m22, m01 + m10, m02 + m20, m21 - m12];
  else if (m11 > m22) q = [m01 + m10, 1 + m11 - m00 - m22, m12 + m21, m02 - m20];
  else q = [m02 + m20, m12 + m21, 1 + m22 - m00 - m11, m10 - m01];
  const length = Math.hypot(q[0], q[1], q[2], q[3]);
  for (let i = 0; i < 4; i++) out[at + i] = q[i] / length;
}
