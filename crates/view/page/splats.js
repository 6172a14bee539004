// Draws Gaussians on triangles with WebGL 2. The definition is `srflow_splat::reference`: the same projection, low-pass filter,
// limits and order; sums are of half or single precision, and no pixel stops early.

const TEXELS = 2048; // width of the textures with data

const PROJECTION = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D gaussians; // position and opacity; scale and triangle; rotation
uniform highp sampler2D colors;
uniform highp isampler2D harmonics;
uniform highp sampler2D factors; // of the light on each Gaussian
uniform highp sampler2D frames; // origin and scale of a triangle; rotation
uniform highp sampler2D framesNext;
uniform vec4 row0, row1, row2; // camera from world
uniform vec3 eye;
uniform vec2 focal, centre, size;
uniform float range; // of the harmonics above degree 0
uniform int degree;
uniform bool antialiased, shaded;
layout(location = 0) in uint order;
flat out vec4 conic; // xx, xy, yy, opacity
flat out vec3 color;
flat out vec3 motion; // displacement in pixels, depth
out vec2 offset;

vec4 at(highp sampler2D data, int n) { return texelFetch(data, ivec2(n % ${TEXELS}, n / ${TEXELS}), 0); }
vec3 rotated(vec4 q, vec3 v) { return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v); }
vec4 product(vec4 a, vec4 b) { return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz)); }
vec3 inCamera(vec3 p) { vec4 h = vec4(p, 1.0); return vec3(dot(row0, h), dot(row1, h), dot(row2, h)); }
vec3 onTriangle(highp sampler2D data, int triangle, vec3 local) {
  vec4 place = at(data, 2 * triangle);
  return rotated(at(data, 2 * triangle + 1), local * place.w) + place.xyz;
}

vec3 seenFrom(int gaussian, vec3 d) {
  vec3 sum = vec3(0.5) + 0.28209479177387814 * at(colors, gaussian).rgb;
  if (degree == 0) return sum;
  int count = (degree + 1) * (degree + 1) - 1;
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  float basis[15] = float[15](
    -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
    1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2.0 * zz - xx - yy),
    -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
    -0.5900435899266435 * y * (3.0 * xx - yy), 2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4.0 * zz - xx - yy),
    0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457994644658 * x * (4.0 * zz - xx - yy),
    1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3.0 * yy));
  for (int k = 0; k < count; k++) {
    int n = gaussian * count + k;
    vec3 coefficient = vec3(texelFetch(harmonics, ivec2(n % ${TEXELS}, n / ${TEXELS}), 0).rgb) * (range / 127.0);
    sum += basis[k] * coefficient;
  }
  return sum;
}

void main() {
  int gaussian = int(order);
  vec4 first = at(gaussians, 3 * gaussian), second = at(gaussians, 3 * gaussian + 1);
  int triangle = int(second.w);
  float size1 = at(frames, 2 * triangle).w;
  vec3 world = onTriangle(frames, triangle, first.xyz);
  vec3 scale = second.xyz * size1;
  vec4 q = normalize(product(at(frames, 2 * triangle + 1), at(gaussians, 3 * gaussian + 2)));
  vec3 p = inCamera(world);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // outside: not drawn
  if (first.w < 1.0 / 255.0) return;

  vec2 margin = 0.15 * size / focal;
  vec2 direction = clamp(p.xy / p.z, (-0.5 - centre) / focal - margin, (size - 0.5 - centre) / focal + margin);
  vec3 jx = vec3(focal.x, 0.0, -focal.x * direction.x) / p.z, jy = vec3(0.0, focal.y, -focal.y * direction.y) / p.z;
  vec3 wx = jx.x * row0.xyz + jx.z * row2.xyz, wy = jy.y * row1.xyz + jy.z * row2.xyz; // image from world
  vec3 a = rotated(q, vec3(1, 0, 0)) * scale.x, b = rotated(q, vec3(0, 1, 0)) * scale.y, c = rotated(q, vec3(0, 0, 1)) * scale.z;
  vec3 u = vec3(dot(wx, a), dot(wx, b), dot(wx, c)), v = vec3(dot(wy, a), dot(wy, b), dot(wy, c));
  float xx = dot(u, u), xy = dot(u, v), yy = dot(v, v);
  float opacity = first.w;
  vec3 normal = cross(u, v);
  float sharp = dot(normal, normal); // the determinant, without cancellation
  xx += 0.3;
  yy += 0.3;
  float determinant = xx * yy - xy * xy;
  if (antialiased) opacity *= sqrt(sharp / determinant);
  float reach = 2.0 * log(255.0 * opacity); // squared, in deviations: where alpha falls below 1/255
  if (!(reach > 0.0)) return;
  conic = vec4(yy / determinant, -xy / determinant, xx / determinant, opacity);
  color = seenFrom(gaussian, normalize(world - eye));
  if (shaded) color = at(factors, gaussian).rgb * (color + 0.055) - 0.055;
  color = max(color, 0.0);

  vec2 pixel = focal * p.xy / p.z + centre;
  motion = vec3(0.0, 0.0, p.z);
  vec3 next = inCamera(onTriangle(framesNext, triangle, first.xyz));
  if (next.z > 0.2) motion.xy = focal * next.xy / next.z + centre - pixel;

  // A rectangle along the axes of the ellipse.
  float middle = 0.5 * (xx + yy), half_ = length(vec2(0.5 * (xx - yy), xy));
  vec2 axis = abs(xy) > 1e-6 * middle ? normalize(vec2(xy, middle + half_ - xx)) : xx > yy ? vec2(1, 0) : vec2(0, 1);
  vec2 lengths = sqrt(reach * vec2(middle + half_, max(middle - half_, 0.0)));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  offset = corner.x * lengths.x * axis + corner.y * lengths.y * vec2(-axis.y, axis.x);
  vec2 place = (pixel + offset + 0.5) / size * 2.0 - 1.0;
  gl_Position = vec4(place.x, -place.y, 0.0, 1.0);
}`;

const BLENDING = `#version 300 es
precision highp float;
flat in vec4 conic;
flat in vec3 color;
flat in vec3 motion;
in vec2 offset;
layout(location = 0) out vec4 seen;
layout(location = 1) out vec4 moved;
void main() {
  float power = -0.5 * (conic.x * offset.x * offset.x + conic.z * offset.y * offset.y) - conic.y * offset.x * offset.y;
  float alpha = min(0.99, conic.w * exp(min(power, 0.0)));
  if (alpha < 1.0 / 255.0) discard;
  seen = vec4(color * alpha, alpha);
  moved = vec4(motion * alpha, alpha);
}`;

const WHOLE = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

const SHOWING = `#version 300 es
precision highp float;
uniform sampler2D seen, moved;
uniform vec3 background, wheel[55];
uniform int layer;
uniform float longest;
uniform vec2 depths;
out vec4 pixel;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 s = texelFetch(seen, at, 0), m = texelFetch(moved, at, 0);
  vec3 shown = s.rgb + (1.0 - s.a) * background;
  if (layer == 1) {
    vec2 flow = m.xy / longest;
    float radius = length(flow);
    float place = (atan(-flow.y, -flow.x) / 3.14159265358979 + 1.0) / 2.0 * 54.0;
    int before = min(int(place), 54);
    vec3 hue = mix(wheel[before], wheel[(before + 1) % 55], place - float(before));
    shown = radius == 0.0 ? vec3(1.0) : radius <= 1.0 ? 1.0 - radius * (1.0 - hue) : 0.75 * hue;
  } else if (layer == 2) {
    float near = (depths.y - m.z / max(m.a, 1e-6)) / (depths.y - depths.x);
    shown = m.a > 0.004 ? vec3(clamp(near, 0.0, 1.0)) * 0.9 + 0.1 : vec3(0.0);
  } else if (layer == 3) {
    shown = vec3(s.a);
  }
  pixel = vec4(shown, 1.0);
}`;

// An arrow at every point of a grid: a line and the two sides of its head.
const ARROW = `#version 300 es
precision highp float;
uniform sampler2D moved;
uniform vec2 size;
uniform float spacing, stretch;
out float shade;
void main() {
  int columns = int(size.x / spacing);
  vec2 from = (vec2(gl_InstanceID % columns, gl_InstanceID / columns) + 0.5) * spacing;
  vec4 m = texelFetch(moved, ivec2(int(from.x), int(size.y - 1.0 - floor(from.y))), 0);
  vec2 flow = m.xy * stretch;
  float length_ = length(flow);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  shade = 1.0;
  if (m.a < 0.5 || length_ < 1.5) return;
  vec2 along = flow / length_, side = vec2(-along.y, along.x);
  float head = min(5.0, 0.4 * length_);
  vec2 tip = from + flow;
  vec2 points[6] = vec2[6](from, tip, tip, tip - head * (along + 0.6 * side), tip, tip - head * (along - 0.6 * side));
  vec2 place = points[gl_VertexID] / size * 2.0 - 1.0;
  gl_Position = vec4(place.x, -place.y, 0.0, 1.0);
}`;

const INK = `#version 300 es
precision highp float;
uniform vec3 ink;
out vec4 pixel;
void main() { pixel = vec4(ink, 1.0); }`;

const LAYERS = ["color", "flow", "depth", "alpha"];

class SplatCanvas {
  /** `arrays` are those of a pack of Gaussians; their triangles' frames come with `setFrames`. */
  constructor(canvas, facts, arrays, triangleCount) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL 2, which the picture needs");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
      throw new Error("this graphics driver cannot draw into pictures of floats, which the sums of Gaussians need");
    }
    this.single = Boolean(gl.getExtension("EXT_float_blend"));
    Object.assign(this, { canvas, gl, facts, triangleCount, count: arrays.triangle_of.length, drawn: 0 });
    this.programs = {
      splats: program(gl, PROJECTION, BLENDING),
      show: program(gl, WHOLE, SHOWING),
      arrows: program(gl, ARROW, INK),
    };
    this.frames = [this.dataTexture(), this.dataTexture()];
    this.factors = this.dataTexture();
    this.shaded = false;
    this.uploadGaussians(arrays);
    this.order = gl.createBuffer();
    this.vertices = gl.createVertexArray();
    gl.bindVertexArray(this.vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.nothing = gl.createVertexArray();
    this.worker = new Worker(URL.createObjectURL(new Blob([document.getElementById("sort").textContent])));
    this.worker.postMessage({ local: arrays.positions, triangles: arrays.triangle_of });
  }

  dataTexture() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    return texture;
  }

  /** Writes groups of four numbers into a texture. */
  upload(texture, internal, format, type, numbers) {
    const { gl } = this;
    const rows = Math.max(1, Math.ceil(numbers.length / 4 / TEXELS));
    const padded = new numbers.constructor(4 * TEXELS * rows);
    padded.set(numbers);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, TEXELS, rows, 0, format, type, padded);
  }

  uploadGaussians({ positions, scales, rotations, opacities, triangle_of, sh_constant, sh_rest }) {
    const { gl, count } = this;
    const data = new Float32Array(12 * count);
    const constant = new Float32Array(4 * count);
    for (let i = 0; i < count; i++) {
      for (let axis = 0; axis < 3; axis++) {
        data[12 * i + axis] = positions[3 * i + axis];
        data[12 * i + 4 + axis] = single(scales[3 * i + axis]);
        constant[4 * i + axis] = single(sh_constant[3 * i + axis]);
      }
      data[12 * i + 3] = single(opacities[i]);
      data[12 * i + 7] = triangle_of[i];
      for (let k = 0; k < 4; k++) data[12 * i + 8 + k] = single(rotations[4 * i + k]);
    }
    const rest = new Int8Array((sh_rest.length / 3) * 4);
    for (let i = 0; i < sh_rest.length / 3; i++) for (let c = 0; c < 3; c++) rest[4 * i + c] = sh_rest[3 * i + c];
    [this.gaussians, this.colors, this.harmonics] = [this.dataTexture(), this.dataTexture(), this.dataTexture()];
    this.upload(this.gaussians, gl.RGBA32F, gl.RGBA, gl.FLOAT, data);
    this.upload(this.colors, gl.RGBA32F, gl.RGBA, gl.FLOAT, constant);
    this.upload(this.harmonics, gl.RGBA8I, gl.RGBA_INTEGER, gl.BYTE, rest);
  }

  /** The frames of the triangles now and after the motion. */
  setFrames(now, next) {
    const { gl } = this;
    [now, next].forEach((frames, i) => this.upload(this.frames[i], gl.RGBA32F, gl.RGBA, gl.FLOAT, frames));
  }

  /** The factors of the light on the Gaussians, four numbers each. */
  setFactors(factors) {
    const { gl } = this;
    this.shaded = true;
    this.upload(this.factors, gl.RGBA32F, gl.RGBA, gl.FLOAT, factors);
  }

  /** The order of the Gaussians in these frames from a camera. */
  sort(frames, camera) {
    return new Promise((resolve) => {
      this.worker.onmessage = ({ data }) => resolve(data.order);
      this.worker.postMessage({ frames: frames.slice(), row: camera.rows[2], near: NEAR });
    });
  }

  setOrder(order) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    this.drawn = order.length;
  }

  resize(width, height) {
    const { gl, canvas } = this;
    if (this.target && canvas.width === width && canvas.height === height) return;
    Object.assign(canvas, { width, height });
    if (this.target) {
      gl.deleteFramebuffer(this.target);
      this.pictures.forEach((picture) => gl.deleteTexture(picture));
    }
    this.target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    this.pictures = [0, 1].map((i) => {
      const picture = this.dataTexture();
      gl.texStorage2D(gl.TEXTURE_2D, 1, this.single ? gl.RGBA32F : gl.RGBA16F, width, height);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, picture, 0);
      return picture;
    });
  }

  use(program, textures) {
    const { gl } = this;
    gl.useProgram(program.handle);
    Object.entries(textures).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(program.uniform(name), unit);
    });
    return program;
  }

  /** Draws the Gaussians, then the layer: `{ layer, background, longest, depths, arrows }`. */
  draw(camera, look) {
    this.resize(camera.width, camera.height);
    this.drawGaussians(camera);
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    const [seen, moved] = this.pictures;
    const show = this.use(this.programs.show, { seen, moved });
    gl.uniform3fv(show.uniform("background"), look.background);
    gl.uniform3fv(show.uniform("wheel"), WHEEL.flat());
    gl.uniform1i(show.uniform("layer"), LAYERS.indexOf(look.layer));
    gl.uniform1f(show.uniform("longest"), Math.max(look.longest, 1e-6));
    gl.uniform2fv(show.uniform("depths"), look.depths);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    if (look.arrows) this.drawArrows(camera, look, moved);
  }

  drawGaussians(camera) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    gl.viewport(0, 0, camera.width, camera.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const [frames, framesNext] = this.frames;
    const { gaussians, colors, harmonics, factors } = this;
    const splats = this.use(this.programs.splats, { gaussians, colors, harmonics, factors, frames, framesNext });
    camera.rows.forEach((row, i) => gl.uniform4fv(splats.uniform(`row${i}`), row));
    gl.uniform3fv(splats.uniform("eye"), camera.eye);
    gl.uniform2f(splats.uniform("focal"), camera.focal, camera.focal);
    gl.uniform2fv(splats.uniform("centre"), camera.centre);
    gl.uniform2f(splats.uniform("size"), camera.width, camera.height);
    gl.uniform1f(splats.uniform("range"), this.facts.sh_range);
    gl.uniform1i(splats.uniform("degree"), this.facts.sh_degree);
    gl.uniform1i(splats.uniform("antialiased"), this.facts.antialiased ? 1 : 0);
    gl.uniform1i(splats.uniform("shaded"), this.shaded ? 1 : 0);
    gl.enable(gl.BLEND); // front to back: what is behind is seen through what is left
    gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
    gl.bindVertexArray(this.vertices);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.drawn);
    gl.disable(gl.BLEND);
  }

  drawArrows(camera, { layer, stretch }, moved) {
    const { gl } = this;
    const spacing = Math.max(10, Math.round(Math.min(camera.width, camera.height) / 40));
    const arrows = this.use(this.programs.arrows, { moved });
    gl.uniform2f(arrows.uniform("size"), camera.width, camera.height);
    gl.uniform1f(arrows.uniform("spacing"), spacing);
    gl.uniform1f(arrows.uniform("stretch"), stretch);
    gl.uniform3fv(arrows.uniform("ink"), layer === "color" ? [0.2, 0.9, 1] : [0.1, 0.1, 0.1]);
    gl.drawArraysInstanced(gl.LINES, 0, 6, Math.floor(camera.width / spacing) * Math.floor(camera.height / spacing));
  }

  /** Sums at a rectangle of pixels, rows from the top: colour and alpha, or flow, depth (times alpha) and alpha. */
  sums(picture, x, y, width, height) {
    const { gl, canvas } = this;
    const out = new Float32Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.readBuffer(gl.COLOR_ATTACHMENT0 + picture);
    gl.readPixels(x, canvas.height - y - height, width, height, gl.RGBA, gl.FLOAT, out);
    const row = 4 * width;
    const upright = new Float32Array(out.length);
    for (let i = 0; i < height; i++) upright.set(out.subarray(i * row, (i + 1) * row), (height - 1 - i) * row);
    return upright;
  }
}

function program(gl, vertex, fragment) {
  const handle = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(handle, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(handle);
  if (!gl.getProgramParameter(handle, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(handle));
  const places = new Map();
  const uniform = (name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(handle, name));
    return places.get(name);
  };
  return { handle, uniform };
}
