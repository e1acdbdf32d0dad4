// Points of a scan from its ranges, and errors of distances between points.

/** @typedef {import("./camera.js").Point} Point */
/** @typedef {[number, number]} Pixel row and column of the scan */
/**
 * Parameters of the correlation between the errors of pixels.
 * @typedef {object} Sharing
 * @property {number[][] | null} matrix of monomials of the beams, into the basis of the reference
 * @property {number[][]} powers of azimuth and elevation in each monomial
 * @property {number[]} middle of azimuth and elevation
 * @property {number[]} factor of azimuth and elevation
 * @property {string[]} alike maps of errors that all pixels share
 * @property {string[]} of_water maps of errors that turn with the modulation phase
 */
/**
 * Data from which lengths are computed.
 * @typedef {object} Measured
 * @property {Beams} beams
 * @property {Sharing | null} sharing
 * @property {string} channel
 * @property {number} group_index
 * @property {number[]} frequencies
 * @property {string} [error_unknown]
 * @property {number} [line_window] size of the windows of phasor lines [pixel]
 * @property {number} rows
 * @property {number} columns
 * @property {(name: string, row: number, column: number) => number} value
 */

const LIGHT = 299792458;
/** Angle below which two directions coincide [rad]. */
const STRAIGHT = 1e-6;

/**
 * @param {number[]} nodes
 * @param {number} at
 * @returns {[number, number, number]}
 */
function between(nodes, at) {
  let low = 0;
  let high = nodes.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (nodes[middle] <= at) low = middle;
    else high = middle - 1;
  }
  const next = Math.min(low + 1, nodes.length - 1);
  return [low, next, (at - nodes[low]) / Math.max(nodes[next] - nodes[low], 1)];
}

/** Beams of a scan, interpolated between the nodes of a coarse grid. */
export class Beams {
  /**
   * @param {{rows: number[], columns: number[]}} nodes
   * @param {ArrayLike<number>} values
   */
  constructor(nodes, values) {
    this.rows = nodes.rows;
    this.columns = nodes.columns;
    this.values = values;
  }

  /**
   * Return the eight numbers of a beam: origin, direction, azimuth, elevation.
   * @param {number} row
   * @param {number} column
   * @returns {number[]}
   */
  at(row, column) {
    const [r0, r1, v] = between(this.rows, row);
    const [c0, c1, u] = between(this.columns, column);
    const width = this.columns.length;
    const out = new Array(8);
    for (let k = 0; k < 8; k += 1) {
      const get = (/** @type {number} */ r, /** @type {number} */ c) =>
        this.values[(r * width + c) * 8 + k];
      out[k] =
        (get(r0, c0) * (1 - u) + get(r0, c1) * u) * (1 - v) +
        (get(r1, c0) * (1 - u) + get(r1, c1) * u) * v;
    }
    return out;
  }

  /**
   * Return the point at a range along a beam: right, down, forward [m].
   * @param {number} row
   * @param {number} column
   * @param {number} range
   * @returns {Point}
   */
  point(row, column, range) {
    const b = this.at(row, column);
    return [b[0] + range * b[3], b[1] + range * b[4], b[2] + range * b[5]];
  }

  /**
   * Return the distances from the first pixel along a row, at one range, for its nodes [m].
   * @param {number} row
   * @param {number} range
   */
  alongRow(row, range) {
    return lengths(this.columns.map((column) => this.point(row, column, range)));
  }

  /**
   * Return the distances from the first pixel along a column, at one range, for its nodes [m].
   * @param {number} column
   * @param {number} range
   */
  alongColumn(column, range) {
    return lengths(this.rows.map((row) => this.point(row, column, range)));
  }
}

/**
 * Return the lengths of a line from its first point to each of its points.
 * @param {number[][]} places
 */
function lengths(places) {
  let length = 0;
  return places.map((place, k) => {
    if (k) length += norm(minus(place, places[k - 1]));
    return length;
  });
}

/**
 * Return a value interpolated linearly in a table with increasing arguments, and continued
 * beyond both ends.
 * @param {number[]} from arguments
 * @param {number[]} to values
 * @param {number} at
 */
export function interpolated(from, to, at) {
  let low = 0;
  while (low < from.length - 2 && from[low + 1] <= at) low += 1;
  const high = Math.min(low + 1, from.length - 1);
  const span = from[high] - from[low];
  return span > 0 ? to[low] + ((at - from[low]) / span) * (to[high] - to[low]) : to[low];
}

/**
 * @param {number[]} a
 * @param {number[]} b
 */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/**
 * @param {number[]} a
 * @param {number[]} b
 */
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/**
 * @param {number[]} a
 */
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);

/**
 * @param {number[]} a
 * @param {number[]} b
 */
const inner = (a, b) => a.reduce((sum, part, k) => sum + part * b[k], 0);

/**
 * Return the unit vector of a pixel in the basis of the reference.
 * @param {Sharing} sharing
 * @param {number[]} beam
 * @returns {number[] | null}
 */
function reference(sharing, beam) {
  const { matrix } = sharing;
  if (!matrix) return null;
  const axes = [0, 1].map((k) => (beam[6 + k] - sharing.middle[k]) * sharing.factor[k]);
  const monomials = sharing.powers.map(([i, j]) => axes[0] ** i * axes[1] ** j);
  const width = matrix[0].length;
  const out = new Array(width).fill(0);
  monomials.forEach((value, k) => {
    for (let m = 0; m < width; m += 1) out[m] += value * matrix[k][m];
  });
  const size = Math.hypot(...out);
  return out.map((value) => value / size);
}

/**
 * Return the variance of the range of a pixel without errors that all pixels share [m^2]; NaN
 * if it is unknown.
 * @param {Measured} scene
 * @param {Pixel} pixel
 */
export function ownVariance(scene, [row, column]) {
  const variance = scene.value("uncertainty", row, column) ** 2;
  if (!scene.sharing) return variance;
  const shared = scene.value("common", row, column) ** 2;
  return Math.max(variance - shared, 4 * Number.EPSILON * variance);
}

/**
 * Return the covariance of the slant ranges of two pixels of a list, as a function of their
 * numbers [m^2], as in amulor.imaging.correlation.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @returns {(i: number, j: number) => number}
 */
export function correlated(scene, pixels) {
  const sharing = scene.sharing;
  const window = scene.line_window ?? 0;
  const turns = scene.frequencies.map((f) => (4 * Math.PI * f * scene.group_index) / LIGHT);
  const all = pixels.map(([row, column]) => {
    const beam = scene.beams.at(row, column);
    const get = (/** @type {string} */ name) => scene.value(name, row, column);
    const total = get("uncertainty");
    const none = { total, noise: total, range: NaN, alike: [], ofWater: [], rest: 0, basis: null };
    if (!sharing) return none;
    const alike = sharing.alike.map(get);
    const ofWater = sharing.of_water.map(get);
    const known = [...alike, ...ofWater].reduce((sum, one) => sum + one * one, 0);
    const common = get("common");
    return {
      total,
      noise: Math.sqrt(Math.max(total * total - common * common, 0)),
      range: get("range"),
      alike,
      ofWater,
      rest: Math.sqrt(Math.max(common * common - known, 0)),
      basis: reference(sharing, beam),
    };
  });
  return (i, j) => {
    const [one, other] = [all[i], all[j]];
    if (i === j || samePixel(pixels[i], pixels[j])) return one.total ** 2;
    // The windows of phasor lines overlap.
    const overlap = window
      ? [0, 1]
          .map((k) => Math.max(1 - Math.abs(pixels[i][k] - pixels[j][k]) / window, 0))
          .reduce((product, part) => product * part)
      : 0;
    const noise = overlap * one.noise * other.noise;
    if (!sharing) return noise;
    let turn = 0;
    for (const k of turns) turn += Math.cos(k * (one.range - other.range)) / turns.length;
    const along = one.basis && other.basis ? inner(one.basis, other.basis) : 1;
    const water = inner(one.ofWater, other.ofWater);
    const alike = inner(one.alike, other.alike);
    return noise + one.rest * other.rest * along * turn + water * turn + alike;
  };
}

/**
 * Return the covariance matrix of the slant ranges of pixels [m^2].
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @returns {number[][]}
 */
export function covariance(scene, pixels) {
  const shared = correlated(scene, pixels);
  return pixels.map((_, i) => pixels.map((__, j) => shared(i, j)));
}

/**
 * @param {Pixel} a
 * @param {Pixel} b
 */
function samePixel(a, b) {
  return a[0] === b[0] && a[1] === b[1];
}

/**
 * Return the pixels within reach of a pixel in a line of pixels, without a step in between.
 * @param {(at: number) => boolean} steps whether the surface steps behind a pixel
 * @param {number} start
 * @param {number} reach
 * @param {number} count
 */
function walked(steps, start, reach, count) {
  let [low, high] = [start, start];
  while (low > Math.max(start - reach, 0) && !steps(low - 1)) low -= 1;
  while (high < Math.min(start + reach, count - 1) && !steps(high)) high += 1;
  return Array.from({ length: high - low + 1 }, (_, k) => low + k);
}

/**
 * Return the pixels of which the mean is a picked point: along the column, then the rows.
 * @param {Measured} scene
 * @param {Pixel} pixel
 * @param {number} reach
 * @returns {Pixel[]}
 */
function around(scene, [row, column], reach) {
  /** @type {(r: number, c: number, bit: number) => boolean} */
  const steps = (r, c, bit) => Boolean(scene.value("steps", r, c) & bit);
  const lines = walked((r) => steps(r, column, 2), row, reach, scene.rows);
  return lines.flatMap((r) =>
    walked((c) => steps(r, c, 1), column, reach, scene.columns)
      .filter((c) => Number.isFinite(scene.value("range", r, c)))
      .map((c) => /** @type {Pixel} */ ([r, c])),
  );
}

/**
 * Return picked points: pixels, with the number of their point and their weight in it.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {number} reach
 */
function picked(scene, pixels, reach) {
  const members = pixels.flatMap((pixel, owner) => {
    if (!Number.isFinite(scene.value("range", ...pixel)))
      throw new Error(`Pixel (${pixel.join(", ")}) holds no range; pick another.`);
    const part = reach ? around(scene, pixel, reach) : [pixel];
    return part.map((member) => ({ pixel: member, owner, weight: 1 / part.length }));
  });
  const places = pixels.map(() => [0, 0, 0]);
  for (const { pixel, owner, weight } of members) {
    const place = scene.beams.point(...pixel, scene.value("range", ...pixel));
    place.forEach((part, k) => (places[owner][k] += weight * part));
  }
  return { members, places };
}

/**
 * Return a measurement with its uncertainty.
 * @param {Measured} scene
 * @param {string} kind
 * @param {ReturnType<typeof picked>} points
 * @param {number} value
 * @param {number[][]} gradient by coordinates of the points
 * @param {string} [unit]
 */
function result(scene, kind, { members }, value, gradient, unit = "m") {
  const slopes = members.map(
    ({ pixel, owner, weight }) =>
      weight * dot(gradient[owner], scene.beams.at(...pixel).slice(3, 6)),
  );
  const pixels = members.map(({ pixel }) => pixel);
  const shared = correlated(scene, pixels);
  /** @type {Map<string, {pixel: Pixel, slope: number}>} */
  const alone = new Map();
  let variance = 0;
  slopes.forEach((a, i) => {
    slopes.forEach((b, j) => (variance += a * b * shared(i, j)));
    const before = alone.get(pixels[i].join());
    alone.set(pixels[i].join(), { pixel: pixels[i], slope: a + (before?.slope ?? 0) });
  });
  let random = 0;
  for (const { pixel, slope } of alone.values()) random += slope ** 2 * ownVariance(scene, pixel);
  return {
    kind,
    channel: scene.channel,
    group_index: scene.group_index,
    lines: [{ label: kind, value, uncertainty: Math.sqrt(Math.max(variance, 0)), unit }],
    error_unknown: scene.error_unknown,
    random: Number.isFinite(random) ? Math.sqrt(random) : undefined,
    pixels: alone.size,
  };
}

/** @type {(a: number[], factor: number) => number[]} */
const times = (a, factor) => a.map((part) => part * factor);
/** @type {(a: number[], b: number[]) => number[]} */
export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/**
 * Return the distance between two pixels, with its uncertainty.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {number} [reach] pixels on each side over which a point is averaged
 */
export function distance(scene, pixels, reach = 0) {
  const points = picked(scene, pixels, reach);
  const step = minus(points.places[1], points.places[0]);
  const length = norm(step);
  if (length === 0) throw new Error("Both points are the same; pick two that are apart.");
  const along = times(step, 1 / length);
  return result(scene, "distance", points, length, [times(along, -1), along]);
}

/**
 * Return the coordinate difference of two pixels along an axis, with uncertainty.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {number[]} [axis]
 * @param {number} [reach]
 */
export function height(scene, pixels, axis = [0, -1, 0], reach = 0) {
  const up = times(axis, 1 / norm(axis));
  const points = picked(scene, pixels, reach);
  const value = dot(up, minus(points.places[1], points.places[0]));
  return result(scene, "height", points, value, [times(up, -1), up]);
}

/**
 * Return the angle at the second of three pixels, with its uncertainty.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {number} [reach]
 */
export function angle(scene, pixels, reach = 0) {
  const points = picked(scene, pixels, reach);
  const [first, corner, second] = points.places;
  const arms = [first, second].map((end) => norm(minus(end, corner)));
  if (Math.min(...arms) === 0)
    throw new Error("Two of the points are the same; pick three that are apart.");
  const a = times(minus(first, corner), 1 / arms[0]);
  const b = times(minus(second, corner), 1 / arms[1]);
  const [sine, cosine] = [norm(cross(a, b)), dot(a, b)];
  if (sine < STRAIGHT) throw new Error("The three points lie on a line; pick a corner off it.");
  const toFirst = times(minus(times(a, cosine), b), 1 / (sine * arms[0]));
  const toSecond = times(minus(times(b, cosine), a), 1 / (sine * arms[1]));
  const toCorner = minus(times(toFirst, -1), toSecond);
  const gradient = [toFirst, toCorner, toSecond];
  return result(scene, "angle", points, Math.atan2(sine, cosine), gradient, "rad");
}

/**
 * Return the area of a polygon with pixels as its corners, with its uncertainty.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {number} [reach]
 */
export function area(scene, pixels, reach = 0) {
  const points = picked(scene, pixels, reach);
  const count = pixels.length;
  // Far origins would cost digits.
  const places = points.places.map((place) => minus(place, points.places[0]));
  const before = places.map((_, k) => places[(k + count - 1) % count]);
  const after = places.map((_, k) => places[(k + 1) % count]);
  const vector = [0, 0, 0];
  places.forEach((place, k) =>
    cross(place, after[k]).forEach((part, axis) => (vector[axis] += part / 2)),
  );
  const size = norm(vector);
  if (size === 0) throw new Error("The corners enclose no area; pick some that are off a line.");
  const normal = times(vector, 1 / size);
  const gradient = places.map((_, k) => times(cross(minus(after[k], before[k]), normal), 0.5));
  return result(scene, "area", points, size, gradient, "m2");
}

/**
 * Marks of pixels for a surface through the grid: 1 for a step to the next column, 2 for a
 * step to the next row, 4 for a pixel off the surface, 8 for a pixel of a triangle.
 * @param {ArrayLike<number>} range
 * @param {ArrayLike<number>} steps
 * @param {(at: number) => boolean} off
 * @param {number} wide
 * @returns {Uint8Array}
 */
export function surfaceMarks(range, steps, off, wide) {
  const marks = new Uint8Array(range.length);
  for (let at = 0; at < range.length; at += 1)
    marks[at] = (steps[at] & 3) | (Number.isFinite(range[at]) && !off(at) ? 0 : 4);
  for (const at of triangles(range, marks, wide)) marks[at] |= 8;
  return marks;
}

/**
 * Return the number of nodes in a line of pixels: every stride-th pixel, and the last.
 * @param {number} count
 * @param {number} stride
 */
export function nodesIn(count, stride) {
  return Math.ceil((count - 1) / stride) + 1;
}

/**
 * Return the corners of the triangles of a surface, as numbers of the nodes of a grid. A cell
 * of four pixels has two triangles, along the diagonal that keeps more of them. A triangle has
 * three usable corners and no step along its two sides in the grid.
 * @param {ArrayLike<number>} range
 * @param {Uint8Array} marks
 * @param {number} wide
 * @param {number} [step] distance of nodes [pixel]
 * @param {number} [stride] size of cells, a multiple of it [pixel]
 */
export function triangles(range, marks, wide, step = 1, stride = step) {
  const high = range.length / wide;
  const across = nodesIn(wide, step);
  const corners = new Uint32Array(6 * (nodesIn(wide, stride) - 1) * (nodesIn(high, stride) - 1));
  let count = 0;
  const usable = (/** @type {number} */ at) => !(marks[at] & 4);
  /** @type {(from: number, to: number, by: number, bit: number) => boolean} */
  const joined = (from, to, by, bit) => {
    for (let at = from; at !== to; at += by) if (marks[at] & bit) return false;
    return usable(from) && usable(to);
  };
  for (let row = 0; row < high - 1; row += stride) {
    const low = Math.min(row + stride, high - 1);
    const [upper, lower] = [row, low].map((line) => Math.ceil(line / step) * across);
    for (let column = 0; column < wide - 1; column += stride) {
      const end = Math.min(column + stride, wide - 1);
      const a = row * wide + column;
      const b = row * wide + end;
      const c = low * wide + column;
      const d = low * wide + end;
      const above = joined(a, b, 1, 1);
      const below = joined(c, d, 1, 1);
      const left = joined(a, c, wide, 2);
      const right = joined(b, d, wide, 2);
      const rising = Number(above && left) + Number(below && right);
      const falling = Number(above && right) + Number(below && left);
      const fall =
        falling > rising ||
        (falling === rising && Math.abs(range[a] - range[d]) < Math.abs(range[b] - range[c]));
      const [first, last] = [Math.ceil(column / step), Math.ceil(end / step)];
      if (above && (fall ? right : left)) {
        corners[count] = upper + first;
        corners[count + 1] = upper + last;
        corners[count + 2] = lower + (fall ? last : first);
        count += 3;
      }
      if (below && (fall ? left : right)) {
        corners[count] = upper + (fall ? first : last);
        corners[count + 1] = lower + last;
        corners[count + 2] = lower + first;
        count += 3;
      }
    }
  }
  return corners.subarray(0, count);
}

/**
 * Return the numbers of the nodes that are drawn as points: those with a range, of which no
 * triangle has the pixel.
 * @param {ArrayLike<number>} range
 * @param {Uint8Array | null} marks null for all nodes with a range
 * @param {number} wide
 * @param {number} [step] distance of nodes [pixel]
 * @param {number} [stride] distance of points, a multiple of it [pixel]
 */
export function dots(range, marks, wide, step = 1, stride = step) {
  const high = range.length / wide;
  const across = nodesIn(wide, step);
  const out = new Uint32Array(Math.ceil(wide / stride) * Math.ceil(high / stride));
  let count = 0;
  for (let row = 0; row < high; row += stride) {
    for (let column = 0; column < wide; column += stride) {
      const at = row * wide + column;
      if (!Number.isFinite(range[at]) || (marks && marks[at] & 8)) continue;
      out[count] = (row / step) * across + column / step;
      count += 1;
    }
  }
  return out.subarray(0, count);
}
