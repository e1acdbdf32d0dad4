// Points of a cloud or mesh at a screen position, and lengths between them.

/** @typedef {import("./camera.js").Point} Point */
/** @typedef {{place: Point, corners: number[], weights: number[]}} Pick */
/** @typedef {{position: Float32Array, faces: Uint32Array | null, count: number}} Shape */
/** @typedef {{x: number, y: number, width: number, height: number}} Spot of a canvas */
/** @typedef {{dot: number, shrinks: boolean}} Dots size, and whether far ones are smaller */
/**
 * Errors by name, whether beams start at the origin, and the offset of all coordinates.
 * @typedef {{numbers: Record<string, ArrayLike<number>>, beams: boolean, centre: number[]}} Known
 */

/**
 * Return the visible point at a canvas position [canvas pixel]; null if there is none.
 * @param {Shape} shape
 * @param {number[]} matrix
 * @param {Spot} spot
 * @param {Dots} dots
 * @returns {Pick | null}
 */
export function seen(
  { position, faces, count },
  matrix,
  { x, y, width, height },
  { dot, shrinks },
) {
  return faces
    ? onMesh(position, faces, matrix, { x, y, width, height })
    : onCloud(position, count, matrix, { x, y, width, height }, { dot, shrinks });
}

/**
 * @param {Float32Array} position
 * @param {number} count
 * @param {number[]} m
 * @param {Spot} spot
 * @param {Dots} dots
 * @returns {Pick | null}
 */
function onCloud(position, count, m, { x, y, width, height }, { dot, shrinks }) {
  // Plain numbers are used for speed: millions of points are searched.
  const [x0, y0, z0, w0, x1, y1, z1, w1, x2, y2, z2, w2, x3, y3, z3, w3] = m;
  const [u, v] = [(2 * x) / width - 1, 1 - (2 * y) / height];
  const [perX, perY] = [2 / width, 2 / height];
  let best = -1;
  let least = Infinity;
  for (let i = 0, at = 0; i < count; i += 1, at += 3) {
    const a = position[at];
    const b = position[at + 1];
    const c = position[at + 2];
    const w = w0 * a + w1 * b + w2 * c + w3;
    if (w <= 0) continue;
    const size = Math.min(Math.max(shrinks ? dot / w : dot, 1.5), 64) / 2 + 2.5;
    const dx = x0 * a + x1 * b + x2 * c + x3 - u * w;
    if (Math.abs(dx) > size * perX * w) continue;
    const dy = y0 * a + y1 * b + y2 * c + y3 - v * w;
    if (Math.abs(dy) > size * perY * w) continue;
    const depth = (z0 * a + z1 * b + z2 * c + z3) / w;
    // Points beyond the clipping planes are not drawn.
    if (Math.abs(depth) <= 1 && depth < least) {
      least = depth;
      best = i;
    }
  }
  if (best < 0) return null;
  return {
    place: [position[3 * best], position[3 * best + 1], position[3 * best + 2]],
    corners: [best],
    weights: [1],
  };
}

/**
 * @param {Float32Array} position
 * @param {Uint32Array} faces
 * @param {number[]} m
 * @param {Spot} spot
 * @returns {Pick | null}
 */
function onMesh(position, faces, m, { x, y, width, height }) {
  const count = position.length / 3;
  const spot = new Float64Array(4 * count);
  for (let i = 0; i < count; i += 1) {
    const [a, b, c] = [position[3 * i], position[3 * i + 1], position[3 * i + 2]];
    const w = m[3] * a + m[7] * b + m[11] * c + m[15];
    spot[4 * i] = (0.5 + (0.5 * (m[0] * a + m[4] * b + m[8] * c + m[12])) / w) * width;
    spot[4 * i + 1] = (0.5 - (0.5 * (m[1] * a + m[5] * b + m[9] * c + m[13])) / w) * height;
    spot[4 * i + 2] = (m[2] * a + m[6] * b + m[10] * c + m[14]) / w;
    spot[4 * i + 3] = w;
  }
  let best = -1;
  let parts = [0, 0, 0];
  let least = Infinity;
  for (let t = 0; t < faces.length; t += 3) {
    const [i, j, k] = [4 * faces[t], 4 * faces[t + 1], 4 * faces[t + 2]];
    if (spot[i + 3] <= 0 || spot[j + 3] <= 0 || spot[k + 3] <= 0) continue;
    const [ax, ay, bx, by, cx, cy] = [
      spot[i] - x,
      spot[i + 1] - y,
      spot[j] - x,
      spot[j + 1] - y,
      spot[k] - x,
      spot[k + 1] - y,
    ];
    const [u, v, w] = [bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx];
    if (!((u >= 0 && v >= 0 && w >= 0) || (u <= 0 && v <= 0 && w <= 0))) continue;
    const total = u + v + w;
    if (total === 0) continue;
    const depth = (u * spot[i + 2] + v * spot[j + 2] + w * spot[k + 2]) / total;
    // Points beyond the clipping planes are not drawn.
    if (Math.abs(depth) <= 1 && depth < least) {
      least = depth;
      best = t;
      parts = [u / spot[i + 3], v / spot[j + 3], w / spot[k + 3]];
    }
  }
  if (best < 0) return null;
  const total = parts[0] + parts[1] + parts[2];
  const weights = parts.map((part) => part / total);
  const corners = [faces[best], faces[best + 1], faces[best + 2]];
  const [x0, y0, z0] = [0, 1, 2].map((axis) =>
    corners.reduce((sum, corner, n) => sum + weights[n] * position[3 * corner + axis], 0),
  );
  return { place: [x0, y0, z0], corners, weights };
}

/**
 * Return a value at a picked point, interpolated within its triangle.
 * @param {ArrayLike<number> | undefined} values
 * @param {{corners: number[], weights: number[]}} pick
 */
export function numberAt(values, { corners, weights }) {
  return values ? corners.reduce((sum, corner, n) => sum + weights[n] * values[corner], 0) : NaN;
}

/**
 * Return the distance of two picks along a direction, and a bound of its error.
 * The file has the error of each point, but not the correlation of two points; the
 * bound holds for every correlation from 0 to 1.
 * @param {Known} scene
 * @param {Pick} one
 * @param {Pick} other
 * @param {number[]} direction
 */
export function lengthAlong(scene, one, other, direction) {
  const value = [0, 1, 2].reduce(
    (sum, k) => sum + (other.place[k] - one.place[k]) * direction[k],
    0,
  );
  const [a, b] = [one, other].map((pick) => errorAlong(scene, pick, direction));
  if (!a || !b) return { value, bound: NaN };
  if (!(a.signed && b.signed)) return { value, bound: Math.abs(a.whole) + Math.abs(b.whole) };
  const shared = Math.max(a.shared ** 2 + b.shared ** 2, (a.shared - b.shared) ** 2);
  return { value, bound: Math.sqrt(a.own ** 2 + b.own ** 2 + shared) };
}

/**
 * @param {Known} scene
 * @param {Pick} pick
 * @param {number[]} direction
 */
function errorAlong({ numbers, beams, centre }, pick, direction) {
  const get = (/** @type {string} */ name) => numberAt(numbers[name], pick);
  const sigma = get("uncertainty");
  if (beams && Number.isFinite(sigma)) {
    // In the axes of the instrument, beams start at the origin.
    const beam = pick.place.map((part, k) => part + centre[k]);
    const cosine =
      beam.reduce((sum, part, k) => sum + part * direction[k], 0) / Math.hypot(...beam);
    const common = Math.min(get("common") ?? NaN, sigma);
    // If a file does not state the shared part of the errors, all may be shared.
    const shared = Number.isFinite(common) ? common : sigma;
    return {
      signed: true,
      whole: sigma * cosine,
      shared: shared * cosine,
      own: Math.sqrt(Math.max(sigma ** 2 - shared ** 2, 0)) * cosine,
    };
  }
  const parts = ["sigma_x", "sigma_y", "sigma_z"].map(get);
  // The sign is unknown: nothing is known about errors that two points share.
  const known = { signed: false, own: NaN, shared: NaN };
  if (parts.every(Number.isFinite)) {
    const whole = parts.reduce((sum, part, k) => sum + Math.abs(part * direction[k]), 0);
    return { ...known, whole };
  }
  return Number.isFinite(sigma) ? { ...known, whole: sigma } : null;
}

/**
 * Return the distance of two picks, and a bound of its error.
 * @param {Known} scene
 * @param {Pick} one
 * @param {Pick} other
 */
export function distanceOf(scene, one, other) {
  const apart = other.place.map((part, k) => part - one.place[k]);
  const value = Math.hypot(...apart);
  if (!(value > 0)) return { value: 0, bound: NaN };
  return {
    ...lengthAlong(
      scene,
      one,
      other,
      apart.map((part) => part / value),
    ),
    value,
  };
}
