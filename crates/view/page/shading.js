// Light on skin that moves: the definition is `srflow_head::Shading`.

const LIGHT = 11; // numbers that describe the light on a vertex: of the sky, the key and the fill by channel, exposure to key and fill

class Shading {
  /** From a pack's `head.shading` and its arrays, for a head. */
  constructor(facts, arrays, head) {
    Object.assign(this, facts); // light, albedo, shadows, folds
    this.triangles = head.triangles;
    this.triangleOf = arrays.triangle_of;
    this.exposures = singles(arrays.exposures);
    this.changes = new Shapes(arrays, "shadow");
    this.changing = [...new Set(arrays.shadow_vertices)];
    this.places = singles(arrays.places);
    this.creases = { gaussians: arrays.crease_gaussians, folds: arrays.crease_folds, reliefs: singles(arrays.crease_reliefs) };
    this.halfways = [this.light.key, this.light.fill].map(([x, y, z]) => unit([x, y, z + 1]));
    this.rest = new Float32Array(8 * (head.triangles.length / 3));
    head.vertices.set(head.shaped);
    head.framesInto(this.rest);
    const count = head.shaped.length / 3;
    this.lit = new Float32Array(LIGHT * count);
    this.atRest = new Float32Array(3 * count);
    const normals = vertexNormals(head.shaped, this.triangles);
    for (let vertex = 0; vertex < count; vertex++) {
      this.lightInto(this.exposures, vertex);
      const normal = normals.subarray(3 * vertex, 3 * vertex + 3);
      this.atRest.set(this.seen(this.lit.subarray(LIGHT * vertex, LIGHT * (vertex + 1)), normal), 3 * vertex);
    }
  }

  /** Writes the light that reaches a vertex with these exposures. */
  lightInto(exposures, vertex) {
    const [sky, key, fill] = exposures.subarray(3 * vertex, 3 * vertex + 3).map((part) => Math.min(Math.max(part, 0), 1));
    const { key_color, fill_color } = this.light;
    const shadow = (seen, color) => [color[0] * seen ** 0.8, color[1] * seen, color[2] * seen ** 1.08];
    this.lit.set([sky ** 0.75, sky, sky ** 1.15, ...shadow(key, key_color), ...shadow(fill, fill_color), key, fill], LIGHT * vertex);
  }

  /** Linear light, by channel, from skin with this normal in this light. */
  seen(lit, [x, y, z]) {
    const { key, fill, ground_color, sky_color, wrap, sheen } = this.light;
    const toKey = key[0] * x + key[1] * y + key[2] * z;
    const toFill = fill[0] * x + fill[1] * y + fill[2] * z;
    const gloss = ([hx, hy, hz]) => Math.max(hx * x + hy * y + hz * z, 0) ** 16;
    const reflected = Math.max(sheen * (lit[9] * gloss(this.halfways[0]) + 0.35 * lit[10] * gloss(this.halfways[1])), 1e-3);
    const up = y * 0.5 + 0.5;
    const channel = (c) => {
      const lambert = (cosine) => Math.max((cosine + wrap[c]) / (1 + wrap[c]), 0);
      const ambient = ground_color[c] + (sky_color[c] - ground_color[c]) * up;
      return this.albedo[c] * (ambient * lit[c] + lit[3 + c] * lambert(toKey) + lit[6 + c] * lambert(toFill)) * 1.12 + reflected;
    };
    return [channel(0), channel(1), channel(2)];
  }

  /** The factors of the light on the Gaussians of the head in a pose with these vertices and frames, four numbers each. */
  factors({ expressions }, vertices, frames) {
    this.shadeVertices(expressions);
    const normals = vertexNormals(vertices, this.triangles);
    const ofVertex = this.vertexFactors(normals);
    const out = new Float32Array(4 * this.triangleOf.length).fill(1);
    const { triangles, triangleOf, places } = this;
    for (let place = 0, at = 0, gaussian = 0; place < places.length; place += 2, at += 4, gaussian++) {
      const t = 3 * triangleOf[gaussian];
      const a = 3 * triangles[t], b = 3 * triangles[t + 1], c = 3 * triangles[t + 2];
      const u = places[place], v = places[place + 1], w = 1 - u - v;
      for (let k = 0; k < 3; k++) out[at + k] = u * ofVertex[a + k] + v * ofVertex[b + k] + w * ofVertex[c + k];
    }
    this.fold(expressions, normals, frames, out);
    return out;
  }

  /** Changes the light on the vertices on which expressions change shadows. */
  shadeVertices(expressions) {
    const exposures = this.exposures.slice();
    this.shadows.forEach((intensity, number) => {
      const shown = intensityOf(intensity, expressions);
      if (shown > 0) this.changes.add(number, shown, exposures);
    });
    for (const vertex of this.changing) this.lightInto(exposures, vertex);
  }

  vertexFactors(normals) {
    const { lit, atRest, exposures } = this;
    const out = new Float32Array(normals.length).fill(1);
    for (let vertex = 0, at = 0; at < normals.length; vertex++, at += 3) {
      if (Number.isNaN(exposures[at])) continue;
      const now = this.seen(lit.subarray(LIGHT * vertex, LIGHT * (vertex + 1)), normals.subarray(at, at + 3));
      for (let k = 0; k < 3; k++) out[at + k] = coded(now[k] / atRest[at + k]);
    }
    return out;
  }

  /** Multiplies the factors of Gaussians in folds. */
  fold(expressions, normals, frames, factors) {
    const { gaussians, folds, reliefs } = this.creases;
    const strengths = this.folds.map(({ at_rest, units }) =>
      Math.min(units.reduce((sum, [most, intensity]) => sum + most * intensityOf(intensity, expressions), at_rest), 1.3));
    for (let i = 0; i < gaussians.length; ) {
      const gaussian = gaussians[i];
      let [x, y, z, seen] = [0, 0, 0, 1];
      for (; gaussians[i] === gaussian; i++) {
        const strength = strengths[folds[i]];
        x += reliefs[4 * i] * strength;
        y += reliefs[4 * i + 1] * strength;
        z += reliefs[4 * i + 2] * strength;
        seen *= 1 - reliefs[4 * i + 3] * strength;
      }
      if (x !== 0 || y !== 0 || z !== 0 || seen < 1) this.foldOne(gaussian, [x, y, z], seen, normals, frames, factors);
    }
  }

  foldOne(gaussian, slope, seen, normals, frames, factors) {
    const triangle = this.triangleOf[gaussian];
    const corners = this.triangles.subarray(3 * triangle, 3 * triangle + 3);
    if (corners.some((vertex) => Number.isNaN(this.exposures[3 * vertex]))) return;
    const places = this.places.subarray(2 * gaussian, 2 * gaussian + 2);
    const normal = unit(mixed(normals, 3, corners, places));
    const turned = multiplied(frames.subarray(8 * triangle + 4, 8 * triangle + 8), inverse(this.rest.subarray(8 * triangle + 4, 8 * triangle + 8)));
    const moved = transformed(matrixOf(turned), slope);
    const folded = unit([normal[0] - moved[0], normal[1] - moved[1], normal[2] - moved[2]]);
    const lit = mixed(this.lit, LIGHT, corners, places);
    const [inFold, flat] = [this.seen(lit, folded), this.seen(lit, normal)];
    [0.8, 1, 1.1].forEach((absorbed, k) => {
      factors[4 * gaussian + k] *= coded((inFold[k] / flat[k]) * (1 - absorbed * (1 - seen)));
    });
  }
}

/** The intensity of an action unit, 0 to 1, from weights of expressions: `[expression, share]` each. */
function intensityOf(shares, expressions) {
  const sum = shares.reduce((total, [expression, share]) => total + share * expressions[expression], 0);
  return Math.min(Math.max(sum, 0), 1);
}

/** Groups of `width` values at a point of a triangle with these corners. */
function mixed(values, width, [a, b, c], [u, v]) {
  const sum = new Float32Array(width);
  const w = 1 - u - v;
  for (let k = 0; k < width; k++) sum[k] = u * values[width * a + k] + v * values[width * b + k] + w * values[width * c + k];
  return sum;
}

/** The factor of an sRGB value and 0.055 for a factor of light. */
function coded(light) {
  return Math.min(Math.max(light, 0.25), 6) ** (1 / 2.4);
}

function unit([x, y, z]) {
  const length = Math.hypot(x, y, z);
  return length > 0 ? [x / length, y / length, z / length] : [0, 1, 0];
}

function inverse([x, y, z, w]) {
  return [-x, -y, -z, w];
}

/** Unit normals of the vertices: of their triangles, weighted by area. */
function vertexNormals(vertices, triangles) {
  const normals = new Float32Array(vertices.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const e1 = [vertices[b] - vertices[a], vertices[b + 1] - vertices[a + 1], vertices[b + 2] - vertices[a + 2]];
    const e2 = [vertices[c] - vertices[a], vertices[c + 1] - vertices[a + 1], vertices[c + 2] - vertices[a + 2]];
    const normal = cross(e1, e2);
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k++) normals[corner + k] += normal[k];
  }
  for (let at = 0; at < normals.length; at += 3) normals.set(unit(normals.subarray(at, at + 3)), at);
  return normals;
}
