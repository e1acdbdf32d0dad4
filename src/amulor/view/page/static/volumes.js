// Volumes over a plane in a saved page, as in amulor.imaging.measure.volumes.

import { stepsOf } from "./edges.js";
import { acrossOf, fitted, pointsOf } from "./fits.js";
import { correlated, cross, minus, ownVariance } from "./geometry.js";
import { product as dot, solved } from "./linear.js";

/** @typedef {[number, number]} Pixel row and column of the scan */
/** @typedef {number[]} Vector */
/** @typedef {import("./geometry.js").Measured} Measured */

/** Most pixels of a covariance; more are lumped. */
const LUMPS = 1500;
/** Corners of a cell in both of its divisions into two triangles: 0 1 above 2 3. */
const TRIANGLES = [
  [0, 1, 2],
  [1, 3, 2],
  [0, 1, 3],
  [0, 3, 2],
];

/**
 * Return for each pixel of a line the usable pixels before and behind it, and their distance.
 * @param {boolean[]} usable
 */
function neighbours(usable) {
  const size = usable.length;
  const low = new Array(size).fill(-1);
  const high = new Array(size).fill(size);
  for (let k = 0; k < size; k += 1) low[k] = usable[k] ? k : k ? low[k - 1] : -1;
  for (let k = size - 1; k >= 0; k -= 1)
    high[k] = usable[k] ? k : k < size - 1 ? high[k + 1] : size;
  return low.map((before, k) => ({
    low: before,
    high: high[k],
    gap: before >= 0 && high[k] < size ? high[k] - before : Infinity,
  }));
}

/**
 * Return for each pixel of a window the two pixels between which it is interpolated, the share
 * of the second, and the width of the gap; gap 0 where there is none.
 * @param {boolean[]} usable
 * @param {number} high
 * @param {number} wide
 */
function interpolation(usable, high, wide) {
  const rows = Array.from({ length: high }, (_, row) =>
    neighbours(usable.slice(row * wide, (row + 1) * wide)),
  );
  const columns = Array.from({ length: wide }, (_, column) =>
    neighbours(Array.from({ length: high }, (__, row) => usable[row * wide + column])),
  );
  return usable.map((_, at) => {
    const [row, column] = [Math.floor(at / wide), at % wide];
    const [beside, above] = [rows[row][column], columns[column][row]];
    const down = above.gap < beside.gap;
    const { low, high: end, gap } = down ? above : beside;
    if (!Number.isFinite(gap)) return { ends: [at, at], share: 0, gap: 0 };
    const place = down ? row - low : column - low;
    const ends = down
      ? [low * wide + column, end * wide + column]
      : [row * wide + low, row * wide + end];
    return { ends, share: gap > 0 ? place / gap : 0, gap: Math.max(gap, 1) };
  });
}

/** Plane of the base, and its derivatives with respect to the ranges of its pixels. */
class Ground {
  /**
   * @param {Measured} scene
   * @param {Pixel[]} base
   */
  constructor(scene, base) {
    const points = pointsOf(scene, base, "plane");
    const { values, doubt } = fitted("plane", points);
    if (doubt) throw new Error(`The base is no plane: ${doubt}.`);
    this.pixels = points.pixels;
    this.normal = [values.normal_x, values.normal_y, values.normal_z];
    this.offset = values.offset;
    this.across = acrossOf(this.normal);
    const rows = points.position.map((place) => this.design(place));
    const closeness = points.direction.map((aim) => dot(aim, this.normal));
    const weight = points.noise.map((noise, k) => 1 / Math.max(noise, 1e-24) / closeness[k] ** 2);
    const matrix = [0, 1, 2].map((i) =>
      [0, 1, 2].map((j) => rows.reduce((sum, row, k) => sum + row[i] * row[j] * weight[k], 0)),
    );
    this.gain = rows.map((row, k) =>
      solved(
        matrix,
        row.map((part) => part * weight[k] * closeness[k]),
      ),
    );
  }

  /**
   * Return the derivatives of the height of a place by two slopes and an offset.
   * @param {Vector} place
   */
  design(place) {
    return [dot(place, this.across[0]), dot(place, this.across[1]), 1];
  }
}

/** Points of a rectangle of pixels, the missing ones interpolated. */
class Surface {
  /**
   * @param {Measured} scene
   * @param {Pixel[]} pixels of a whole rectangle, row by row
   * @param {number} wide
   * @param {{usable: boolean[], inside: boolean[]}} which pixels are measured, and in the region
   */
  constructor(scene, pixels, wide, { usable, inside }) {
    this.pixels = pixels;
    this.wide = wide;
    this.high = pixels.length / wide;
    const range = (/** @type {number} */ at) =>
      usable[at] ? scene.value("range", ...pixels[at]) : 0;
    this.weights = interpolation(usable, this.high, wide);
    const beams = pixels.map(([row, column]) => scene.beams.at(row, column));
    this.direction = beams.map((beam) => beam.slice(3, 6));
    this.position = beams.map((beam, at) => {
      const { ends, share } = this.weights[at];
      const filled = range(ends[0]) * (1 - share) + range(ends[1]) * share;
      return [0, 1, 2].map((k) => beam[k] + filled * beam[3 + k]);
    });
    const there = inside.map((one, at) => one && this.weights[at].gap > 0);
    /** @type {number[][]} */
    this.cells = [];
    this.whole = new Uint8Array(pixels.length);
    for (let row = 0; row < this.high - 1; row += 1)
      for (let column = 0; column < wide - 1; column += 1) {
        const at = row * wide + column;
        const corners = [at, at + 1, at + wide, at + wide + 1];
        if (!corners.every((corner) => there[corner])) continue;
        this.cells.push(corners);
        this.whole[at] = 1;
      }
    if (!this.cells.length)
      throw new Error("The rectangle has no cell of four pixels; enlarge it.");
    const grid = (/** @type {(at: number) => number} */ get) => ({
      high: this.high,
      wide,
      values: Float64Array.from(pixels, (_, at) => get(at)),
    });
    this.steps = stepsOf(
      grid((at) => (usable[at] ? scene.value("range", ...pixels[at]) : NaN)),
      grid((at) => ownVariance(scene, pixels[at])),
    );
  }

  /**
   * Return the volume, and its derivatives by the places of the points and by the plane.
   * @param {Ground} ground
   */
  sum(ground) {
    const { normal, offset, across } = ground;
    const byPoint = this.position.map(() => [0, 0, 0]);
    const byPlane = [0, 0, 0];
    let total = 0;
    for (const cell of this.cells)
      for (const names of TRIANGLES) {
        const corners = names.map((name) => cell[name]);
        const places = corners.map((corner) => this.position[corner]);
        const mean = places.reduce((sum, place) => sum + dot(place, normal) - offset, 0) / 3;
        const vector = cross(minus(places[1], places[0]), minus(places[2], places[0]));
        const area = -dot(vector, normal) / 2;
        // Each of the two divisions of a cell counts by half.
        total += (area * mean) / 2;
        corners.forEach((corner, k) => {
          const opposite = minus(places[(k + 1) % 3], places[(k + 2) % 3]);
          const away = cross(opposite, normal);
          for (let i = 0; i < 3; i += 1)
            byPoint[corner][i] += (area * normal[i]) / 6 - (mean * away[i]) / 4;
        });
        const designs = places.map((place) => ground.design(place));
        for (let i = 0; i < 3; i += 1)
          byPlane[i] -= (area * (designs[0][i] + designs[1][i] + designs[2][i])) / 6;
        for (let i = 0; i < 2; i += 1) byPlane[i] += (mean * dot(vector, across[i])) / 4;
      }
    return { total, byPoint, byPlane };
  }

  /**
   * Return the variance of the volume due to unknown places of edges between pixels [m^6].
   * @param {Vector} normal
   */
  edges(normal) {
    const { high, wide, position, weights, whole } = this;
    const levels = position.map((place) => dot(place, normal));
    let total = 0;
    /** @type {[number, number, number, number, Float64Array][]} */
    const axes = [
      [high - 1, wide, wide, 1, this.steps.down],
      [wide - 1, high, 1, wide, this.steps.across],
    ];
    for (const [lines, count, by, beside, steps] of axes) {
      for (let line = 0; line < lines; line += 1) {
        let error = 0;
        for (let k = 0; k < count; k += 1) {
          const at = line * by + k * beside;
          const gap = Math.max(weights[at].gap, weights[at + by].gap);
          const near = steps[at] || gap > 1;
          const cell = (k < count - 1 && whole[at]) || (k > 0 && whole[at - beside]);
          if (!near || !cell) continue;
          const [before, after] = [k > 0 ? at - beside : at, k < count - 1 ? at + beside : at];
          const apart = (after - before) / beside;
          const along = minus(position[at + by], position[at]);
          const sideways = apart
            ? minus(position[after], position[before]).map((part) => part / apart)
            : along;
          const area = Math.abs(dot(cross(along, sideways), normal));
          error += Math.abs(levels[at + by] - levels[at]) * area * gap ** 1.5;
        }
        total += error ** 2 / 12;
      }
    }
    return total;
  }
}

/**
 * Return the variances of the volume due to pixel noise, and due to correlated errors, of which
 * a pixel stands for its surroundings.
 * @param {Measured} scene
 * @param {Map<number, number>} gradient
 * @param {number} stride
 */
function variances(scene, gradient, stride) {
  const keys = [...gradient.keys()].filter((key) => gradient.get(key) !== 0).sort((a, b) => a - b);
  const step = Math.ceil(Math.sqrt(keys.length / LUMPS)) * stride;
  /** @type {Map<number, {pixel: Pixel, sum: number}>} */
  const lumps = new Map();
  let random = 0;
  for (const key of keys) {
    const value = /** @type {number} */ (gradient.get(key));
    /** @type {Pixel} */
    const pixel = [Math.floor(key / scene.columns), key % scene.columns];
    random += value ** 2 * ownVariance(scene, pixel);
    const block = Math.floor(pixel[0] / step) * scene.columns + Math.floor(pixel[1] / step);
    const lump = lumps.get(block);
    if (lump) lump.sum += value;
    else lumps.set(block, { pixel, sum: value });
  }
  const all = [...lumps.values()];
  const covariance = correlated(
    scene,
    all.map(({ pixel }) => pixel),
  );
  let shared = 0;
  all.forEach((one, i) => {
    shared += one.sum ** 2 * (covariance(i, i) - ownVariance(scene, one.pixel));
    for (let j = 0; j < i; j += 1) shared += 2 * one.sum * all[j].sum * covariance(i, j);
  });
  return { random, shared, pixels: keys.length };
}

/**
 * Return the volume between the surface of a rectangle and a plane, as the server does.
 * @param {Measured} scene
 * @param {{pixels: Pixel[], wide: number, usable: boolean[], inside: boolean[]}} region
 * @param {Pixel[]} base
 * @param {number} stride
 */
export function volume(scene, { pixels, wide, usable, inside }, base, stride) {
  const ground = new Ground(scene, base);
  const surface = new Surface(scene, pixels, wide, { usable, inside });
  const { total, byPoint, byPlane } = surface.sum(ground);
  /** @type {Map<number, number>} */
  const gradient = new Map();
  const add = (/** @type {Pixel} */ [row, column], /** @type {number} */ value) => {
    const key = row * scene.columns + column;
    gradient.set(key, (gradient.get(key) ?? 0) + value);
  };
  byPoint.forEach((slope, at) => {
    const along = dot(slope, surface.direction[at]);
    const { ends, share } = surface.weights[at];
    if (along === 0) return;
    add(pixels[ends[0]], along * (1 - share));
    if (share) add(pixels[ends[1]], along * share);
  });
  ground.pixels.forEach((pixel, k) => add(pixel, dot(byPlane, ground.gain[k])));
  const { random, shared, pixels: count } = variances(scene, gradient, stride);
  const uncertainty = Math.sqrt(Math.max(random + shared, 0) + surface.edges(ground.normal));
  return {
    kind: "volume",
    channel: scene.channel,
    group_index: scene.group_index,
    error_unknown: scene.error_unknown,
    lines: [{ label: "volume", value: total, uncertainty, unit: "m3" }],
    random: Math.sqrt(random),
    pixels: count,
  };
}
