// Further points of a large cloud where the view is close: a view at rest requests them.

/** Share of the points in view above which the drawn points are enough. */
const WHOLE = 0.6;
/** Largest number of points by which the visible part is estimated. */
const SAMPLE = 100000;
/** Share of a view by which the requested box is larger, so that small motions need nothing. */
const ROOM = 0.15;

/** @typedef {{low: number[], high: number[]}} Box */

/**
 * Return the box around the points in view up to a depth, and their share of all; null if none
 * is in view.
 * @param {Float32Array} position
 * @param {number} count
 * @param {number[]} m of the camera
 * @param {number} [reach] depth in a perspective view [m]
 */
export function boxInView(position, count, m, reach = Infinity) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  const sample = Math.min(count, SAMPLE);
  let inside = 0;
  for (let at = 0; at < 3 * sample; at += 3) {
    const place = position.subarray(at, at + 3);
    const [x, y, z, w] = [0, 1, 2, 3].map(
      (row) => m[row] * place[0] + m[4 + row] * place[1] + m[8 + row] * place[2] + m[12 + row],
    );
    if (!(w > 0) || w > reach || Math.abs(x) > w || Math.abs(y) > w || Math.abs(z) > w) continue;
    inside += 1;
    for (let k = 0; k < 3; k += 1) {
      low[k] = Math.min(low[k], place[k]);
      high[k] = Math.max(high[k], place[k]);
    }
  }
  return inside ? { box: { low, high }, share: inside / sample } : null;
}

/**
 * Return whether a box contains another one.
 * @param {Box | null} outer
 * @param {Box} inner
 */
function contains(outer, { low, high }) {
  return (
    outer !== null &&
    low.every((value, k) => value >= outer.low[k]) &&
    high.every((value, k) => value <= outer.high[k])
  );
}

/**
 * Return the arrays in an answer of the server: positions, values by layer, and colors.
 * @param {ArrayBuffer} buffer
 * @param {string[]} layers
 * @param {boolean} coloured
 */
export function unpackedPoints(buffer, layers, coloured) {
  const [count] = new Uint32Array(buffer, 0, 1);
  let at = 4;
  const floats = (/** @type {number} */ size) => {
    const values = new Float32Array(buffer, at, size);
    at += 4 * size;
    return values;
  };
  const position = floats(3 * count);
  const numbers = Object.fromEntries(layers.map((name) => [name, floats(count)]));
  const colour = coloured ? new Uint8Array(buffer, at, 3 * count) : null;
  return { count, position, numbers, colour };
}

/** Requests of further points: one at a time, none for a part that is there. */
export class Closer {
  /** Spacing of the points in view, relative to that of all. */
  spacing = 1;
  /** @type {Box | null} */
  #box = null;
  #fine = 1;
  #waiting = false;
  #request;

  /** @param {(box: Box) => Promise<number>} request returns the number of points that it added */
  constructor(request) {
    this.#request = request;
  }

  /**
   * Request the points of a view, unless the drawn points are enough. Return whether the points
   * or their spacing have changed.
   * @param {Float32Array} position
   * @param {number} count
   * @param {number[]} matrix
   * @param {number} [reach] depth in a perspective view [m]
   */
  async look(position, count, matrix, reach) {
    if (this.#waiting) return false;
    const seen = boxInView(position, count, matrix, reach);
    const before = this.spacing;
    const there = seen !== null && seen.share <= WHOLE && contains(this.#box, seen.box);
    this.spacing = there ? this.#fine : 1;
    if (!seen || seen.share > WHOLE || there) return this.spacing !== before;
    const { low, high } = seen.box;
    const room = low.map((value, k) => ROOM * (high[k] - value));
    const box = {
      low: low.map((value, k) => value - room[k]),
      high: high.map((value, k) => value + room[k]),
    };
    this.#waiting = true;
    try {
      const added = await this.#request(box);
      const few = seen.share * count;
      [this.#box, this.#fine] = [box, Math.sqrt(few / (few + added))];
      this.spacing = this.#fine;
    } finally {
      this.#waiting = false;
    }
    return true;
  }
}
