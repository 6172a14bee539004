// A pinhole camera on a sphere around a centre. Axes are OpenCV's: x right, y down, z forward; an integer coordinate is the centre
// of a pixel. At rest it is `Camera::facing` of srflow-splat.

const HALF_ANGLE = (15 * Math.PI) / 180; // half the field of view along the shorter side
const NEAR = 0.2;

class OrbitCamera {
  constructor({ centre, radius }, upsideDown) {
    this.seen = { centre, radius, upsideDown };
    this.reset();
  }

  reset() {
    this.centre = [...this.seen.centre];
    this.distance = Math.max(this.seen.radius / Math.sin(HALF_ANGLE), this.seen.radius + 2 * NEAR);
    this.yaw = 0; // of the camera about the centre, to its right
    this.pitch = 0; // upwards
    this.upsideDown = this.seen.upsideDown; // -y is up
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, -1.55), 1.55);
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.05 * this.seen.radius), 50 * this.seen.radius);
  }

  /** Moves the centre by pixels of a picture of this size. */
  pan(dx, dy, width, height) {
    const { right, down } = this.axes();
    const perPixel = this.distance / this.focal(width, height);
    this.centre = this.centre.map((x, i) => x - perPixel * (dx * right[i] + dy * down[i]));
  }

  focal(width, height) {
    return Math.min(width, height) / (2 * Math.tan(HALF_ANGLE));
  }

  axes() {
    const [sy, cy, sp, cp] = [Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch)];
    const sign = this.upsideDown ? -1 : 1;
    const right = [cy, 0, -sy * sign];
    const forward = [-sy * cp, -sp * sign, -cy * cp * sign];
    return { right, down: cross(forward, right), forward };
  }

  /** Position, focal length and camera from world for a picture of this size. */
  at(width, height) {
    const { right, down, forward } = this.axes();
    const eye = this.centre.map((x, i) => x - this.distance * forward[i]);
    const rows = [right, down, forward].map((axis) => [...axis, -(axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2])]);
    return { eye, rows, focal: this.focal(width, height), width, height, centre: [(width - 1) / 2, (height - 1) / 2] };
  }
}
