// Camera that orbits its target; matrices have the element order of WebGL.

/** @typedef {[number, number, number]} Point */

/**
 * @param {number} value
 * @param {number} low
 * @param {number} high
 */
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

/**
 * @param {number[]} a
 * @param {number[]} b
 */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Camera that orbits a point; "up" is the upward direction in the water. */
export class Camera {
  /** Angle from the lowest to the highest line of sight [rad]. */
  static ANGLE = (38 * Math.PI) / 180;

  orthographic = false;
  /** @type {{target: Point, size: number}} */
  start = { target: [0, 0, 1], size: 1 };
  /** @type {Point} */
  target = [0, 0, 1];
  distance = 1.3;
  turn = -0.5;
  rise = 0.42;

  /**
   * Look at an object of a given size, slightly from above and from the side.
   * @param {{target: Point, size: number}} thing
   */
  home({ target, size }) {
    this.start = { target, size };
    this.target = [target[0], target[1], target[2]];
    this.distance = size * 1.3;
    this.turn = -0.5;
    this.rise = 0.42;
  }

  /**
   * Move so close that all points just fit into a view of a given aspect ratio.
   * @param {number[][]} places
   * @param {number} aspect
   */
  fit(places, aspect) {
    const { forward, right, up } = this.frame();
    const share = 0.92 * Math.tan(Camera.ANGLE / 2);
    let distance = 0;
    for (const place of places) {
      const [x, y, z] = [right, up, forward].map((axis) =>
        axis.reduce((sum, part, k) => sum + part * (place[k] - this.target[k]), 0),
      );
      const needed =
        Math.max(Math.abs(y), Math.abs(x) / aspect) / share - (this.orthographic ? 0 : z);
      distance = Math.max(distance, needed);
    }
    if (distance > 0) this.distance = clamp(distance, this.start.size * 0.01, this.start.size * 20);
  }

  /** Look along the beams, as in the map. */
  straight() {
    this.turn = 0;
    this.rise = 0;
  }

  /** Look down from above. */
  above() {
    this.turn = 0;
    this.rise = 1.55;
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  orbit(dx, dy) {
    this.turn -= dx;
    this.rise = clamp(this.rise + dy, -1.55, 1.55);
  }

  /**
   * @param {number} factor
   */
  zoom(factor) {
    const size = this.start.size;
    this.distance = clamp(this.distance * factor, size * 0.01, size * 20);
  }

  /**
   * Move by fractions of the view's height.
   * @param {number} dx
   * @param {number} dy
   */
  pan(dx, dy) {
    const { right, up } = this.frame();
    const span = this.span();
    for (let k = 0; k < 3; k += 1) this.target[k] += (-dx * right[k] + dy * up[k]) * span;
  }

  /** Return the height of the view at the distance of the target [m]. */
  span() {
    return 2 * this.distance * Math.tan(Camera.ANGLE / 2);
  }

  frame() {
    const ct = Math.cos(this.turn);
    const st = Math.sin(this.turn);
    const cr = Math.cos(this.rise);
    const sr = Math.sin(this.rise);
    // Instrument axes: right, down, forward. Without a turn it looks forward.
    const forward = [-st * cr, sr, ct * cr];
    const right = [ct, 0, st];
    const up = [-st * sr, -cr, ct * sr];
    return { forward, right, up };
  }

  eye() {
    const { forward } = this.frame();
    return this.target.map((part, k) => part - forward[k] * this.distance);
  }

  /** Return the distances of the near and the far clipping plane [m]. */
  planes() {
    return [
      Math.max(this.distance - 6 * this.start.size, this.distance * 0.02),
      this.distance + 8 * this.start.size,
    ];
  }

  /**
   * Return the matrix from coordinates [m] to the view.
   * @param {number} aspect
   */
  matrix(aspect) {
    const { forward, right, up } = this.frame();
    const eye = this.eye();
    const view = [0, 1, 2].flatMap((k) => [right[k], up[k], -forward[k], 0]);
    view.push(-dot(right, eye), -dot(up, eye), dot(forward, eye), 1);
    const [near, far] = this.planes();
    const deep = far - near;
    if (this.orthographic) {
      const half = this.span() / 2;
      const depth = { a: -2 / deep, b: -(far + near) / deep, c: 0, d: 1 };
      return multiplied(projection(1 / (half * aspect), 1 / half, depth), view);
    }
    const focal = 1 / Math.tan(Camera.ANGLE / 2);
    const depth = { a: -(far + near) / deep, b: (-2 * far * near) / deep, c: -1, d: 0 };
    return multiplied(projection(focal / aspect, focal, depth), view);
  }
}

/**
 * Return center and size of points without outliers, and these points, so that a few
 * far points do not shrink the view.
 * @param {Point[]} places
 */
export function extent(places) {
  const ends = [0, 1, 2].map((k) => {
    const sorted = places.map((place) => place[k]).sort((a, b) => a - b);
    return [0.01 * sorted.length, 0.99 * (sorted.length - 1)].map((at) => sorted[Math.floor(at)]);
  });
  const size = Math.hypot(...ends.map(([low, high]) => high - low)) || 0.1;
  const [x, y, z] = ends.map(([low, high]) => (low + high) / 2);
  return {
    /** @type {Point} */
    target: [x, y, z],
    size,
    inside: places.filter((place) =>
      place.every((part, k) => part >= ends[k][0] && part <= ends[k][1]),
    ),
  };
}

/**
 * Return a matrix that scales x and y, and maps z to (a z + b) / (c z + d).
 * @param {number} x
 * @param {number} y
 * @param {{a: number, b: number, c: number, d: number}} depth
 */
function projection(x, y, { a, b, c, d }) {
  // prettier-ignore
  return [
    x, 0, 0, 0,
    0, y, 0, 0,
    0, 0, a, c,
    0, 0, b, d,
  ];
}

/**
 * Return the product of two matrices.
 * @param {number[]} a
 * @param {number[]} b
 */
export function multiplied(a, b) {
  const out = new Array(16).fill(0);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      for (let k = 0; k < 4; k += 1) out[column * 4 + row] += a[k * 4 + row] * b[column * 4 + k];
    }
  }
  return out;
}

/**
 * Return the position of a point on a canvas [canvas pixel]; null behind the camera.
 * @param {number[]} matrix
 * @param {number[]} point
 * @param {number} width
 * @param {number} height
 * @returns {[number, number] | null}
 */
export function projected(matrix, point, width, height) {
  const out = [0, 1, 2, 3].map(
    (row) =>
      matrix[row] * point[0] +
      matrix[4 + row] * point[1] +
      matrix[8 + row] * point[2] +
      matrix[12 + row],
  );
  if (out[3] <= 0) return null;
  return [(0.5 + (0.5 * out[0]) / out[3]) * width, (0.5 - (0.5 * out[1]) / out[3]) * height];
}
