// The camera of the page, which mouse, keys and touch move. The camera either flies, or walks on the ground
// and stops at walls.

import { add, cross, norm, unit } from './math.mjs';

const ANGLE = 70 * Math.PI / 180;
// The minimum distance from walls, and the maximum height of a step, as fractions of the eye's height.
const APART = 0.2, STEP = 0.45;

export class Camera {
  // `upAxis` is 1 or 2, and `size` is the length of the scene.
  constructor(upAxis, size) {
    this.turned = (v) => upAxis === 1 ? v : [v[0], -v[2], v[1]];
    this.up = this.turned([0, 1, 0]);
    this.size = size;
    this.eye = [0, 0, 0];
    this.yaw = this.pitch = 0;
    this.speed = size / 12;
    this.walks = false;
    this.height = size / 100;
    this.keys = new Set();
    this.push = [0, 0];
  }

  get forward() {
    const c = Math.cos(this.pitch);
    return this.turned([c * Math.sin(this.yaw), Math.sin(this.pitch), -c * Math.cos(this.yaw)]);
  }

  get angle() { return ANGLE; }

  look(dx, dy) {
    this.yaw += dx;
    this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + dy));
  }

  // Turns the camera to a direction.
  toward(d) {
    const [x, y, z] = this.up[1] ? d : [d[0], d[2], -d[1]];
    this.yaw = Math.atan2(x, -z);
    this.pitch = Math.max(-1.55, Math.min(1.55, Math.atan2(y, Math.hypot(x, z))));
  }

  // Returns the height of the eye above the triangle below it, or null without such a triangle.
  above(tracer) {
    const down = this.up.map((c) => -c), [hit, t] = tracer.first_hit(this.eye, down);
    return hit < 0 ? null : t;
  }

  // Moves for a number of seconds. Returns true if the eye moved or turned.
  move(seconds, tracer) {
    const k = this.keys, level = this.turned([Math.sin(this.yaw), 0, -Math.cos(this.yaw)]);
    const ahead = this.walks ? level : this.forward, right = unit(cross(ahead, this.up));
    const along = (k.has('KeyW') || k.has('ArrowUp')) - (k.has('KeyS') || k.has('ArrowDown')) + this.push[1];
    const aside = k.has('KeyD') - k.has('KeyA') + this.push[0], rise = k.has('KeyE') - k.has('KeyQ');
    const turn = k.has('ArrowRight') - k.has('ArrowLeft');
    this.look(turn * seconds * 1.5, 0);
    let d = add(add([0, 0, 0], ahead, along), right, aside);
    if (!this.walks) d = add(d, this.up, rise);
    const far = this.speed * seconds * (k.has('ShiftLeft') || k.has('ShiftRight') ? 4 : 1);
    if (!this.walks || !tracer) {
      if (!along && !aside && !(rise && !this.walks)) return turn !== 0;
      this.eye = add(this.eye, unit(d), far);
      return true;
    }
    const before = this.eye;
    if (along || aside) this.step(unit(d), far, tracer);
    // Fall or climb to the eye's height.
    const above = this.above(tracer);
    if (above !== null) {
      const off = this.height - above;
      const most = this.speed * seconds;
      this.eye = add(this.eye, this.up, Math.max(-most, Math.min(most, off)));
    }
    return turn !== 0 || this.eye.some((x, a) => Math.abs(x - before[a]) > 1e-7 * this.size);
  }

  // Moves along a level direction, up to an obstacle at the height of the eye or of the knee.
  step(to, far, tracer) {
    const apart = APART * this.height, knee = add(this.eye, this.up, -(1 - STEP) * this.height);
    const free = (p) => Math.max(0, tracer.first_hit(p, to)[1] - apart);
    this.eye = add(this.eye, to, Math.min(far, free(this.eye), free(knee)));
  }

  // Moves sideways and ahead, for a gesture of two fingers.
  drag(aside, ahead, tracer) {
    const forward = this.walks ? this.turned([Math.sin(this.yaw), 0, -Math.cos(this.yaw)]) : this.forward;
    const d = add(add([0, 0, 0], forward, ahead), unit(cross(forward, this.up)), aside), far = norm(d);
    if (far && this.walks) this.step(unit(d), far, tracer); else this.eye = add(this.eye, d, 1);
  }
}
