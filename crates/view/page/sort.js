// A worker that sorts Gaussians by depth, front to back. The first message brings them; every other one the frames of their
// triangles and the camera, and is answered with their order.

let local, triangles, depths, keys, from, to, counts;

onmessage = ({ data }) => {
  if (data.local) {
    ({ local, triangles } = data);
    const count = triangles.length;
    depths = new Float32Array(count);
    keys = new Uint32Array(depths.buffer);
    from = new Uint32Array(count);
    to = new Uint32Array(count);
    counts = new Uint32Array(65536);
    return;
  }
  const visible = findDepths(data.frames, data.row, data.near);
  byDigit(from, to, visible, 0);
  byDigit(to, from, visible, 16);
  const order = from.slice(0, visible);
  postMessage({ id: data.id, order, frames: data.frames }, [order.buffer, data.frames.buffer]);
};

/** Depths of all Gaussians, and in `from` those in front of the camera. Returns their number. */
function findDepths(frames, [rx, ry, rz, rw], near) {
  const parts = new Float32Array(frames.length / 2); // depth = a x + b y + c z + d of a local point
  for (let f = 0, p = 0; f < frames.length; f += 8, p += 4) {
    const [x, y, z, scale, qx, qy, qz, qw] = frames.subarray(f, f + 8);
    // The row of the camera times the rotation of the triangle.
    parts[p] = scale * (rx * (1 - 2 * (qy * qy + qz * qz)) + ry * 2 * (qx * qy + qz * qw) + rz * 2 * (qx * qz - qy * qw));
    parts[p + 1] = scale * (rx * 2 * (qx * qy - qz * qw) + ry * (1 - 2 * (qx * qx + qz * qz)) + rz * 2 * (qy * qz + qx * qw));
    parts[p + 2] = scale * (rx * 2 * (qx * qz + qy * qw) + ry * 2 * (qy * qz - qx * qw) + rz * (1 - 2 * (qx * qx + qy * qy)));
    parts[p + 3] = rx * x + ry * y + rz * z + rw;
  }
  let visible = 0;
  for (let i = 0; i < triangles.length; i++) {
    const p = 4 * triangles[i];
    const depth = parts[p] * local[3 * i] + parts[p + 1] * local[3 * i + 1] + parts[p + 2] * local[3 * i + 2] + parts[p + 3];
    depths[i] = depth;
    if (depth > near) from[visible++] = i;
  }
  return visible;
}

/** One pass of a radix sort; positive floats have the order of their bits. */
function byDigit(source, target, count, shift) {
  counts.fill(0);
  for (let i = 0; i < count; i++) counts[(keys[source[i]] >>> shift) & 65535]++;
  for (let digit = 0, sum = 0; digit < 65536; digit++) [counts[digit], sum] = [sum, sum + counts[digit]];
  for (let i = 0; i < count; i++) target[counts[(keys[source[i]] >>> shift) & 65535]++] = source[i];
}
