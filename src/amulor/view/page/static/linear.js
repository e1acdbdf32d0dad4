// Small matrices, and least squares of functions of a few parameters.

/** @typedef {number[][]} Matrix rows of numbers */

/** Steps of derivatives, relative to parameters above 1. */
const STEP = 1e-6;
/** Most steps towards a minimum; a shape that fits needs a tenth of them. */
const STEPS = 400;
/** Relative change of the parameters at which the minimum is reached. */
const REACHED = 1e-12;

/**
 * Return the solution of linear equations, by elimination with pivots.
 * @param {Matrix} matrix
 * @param {number[]} right
 * @returns {number[]}
 */
export function solved(matrix, right) {
  const size = right.length;
  const rows = matrix.map((row, k) => [...row, right[k]]);
  for (let k = 0; k < size; k += 1) {
    let best = k;
    for (let i = k + 1; i < size; i += 1)
      if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
    [rows[k], rows[best]] = [rows[best], rows[k]];
    for (let i = 0; i < size; i += 1) {
      if (i === k) continue;
      const factor = rows[i][k] / rows[k][k];
      for (let j = k; j <= size; j += 1) rows[i][j] -= factor * rows[k][j];
    }
  }
  return rows.map((row, k) => row[size] / row[k]);
}

/**
 * @param {Matrix} matrix
 * @returns {Matrix}
 */
export function inverted(matrix) {
  const columns = matrix.map((_, k) =>
    solved(
      matrix,
      matrix.map((__, i) => Number(i === k)),
    ),
  );
  return matrix.map((_, i) => columns.map((column) => column[i]));
}

/**
 * Return eigenvalues and eigenvectors of a symmetric matrix by rotations (Jacobi), the largest
 * first.
 * @param {Matrix} matrix
 * @returns {{value: number, vector: number[]}[]}
 */
export function eigen(matrix) {
  const size = matrix.length;
  const a = matrix.map((row) => [...row]);
  const v = matrix.map((_, i) => matrix.map((__, j) => Number(i === j)));
  for (let sweep = 0; sweep < 60; sweep += 1) {
    for (let p = 0; p < size; p += 1)
      for (let q = p + 1; q < size; q += 1) if (a[p][q] !== 0) rotated(a, v, p, q);
  }
  return a
    .map((row, k) => ({ value: row[k], vector: v.map((line) => line[k]) }))
    .sort((one, other) => other.value - one.value);
}

/**
 * Rotate two axes so that their element off the diagonal vanishes.
 * @param {Matrix} a
 * @param {Matrix} v
 * @param {number} p
 * @param {number} q
 */
function rotated(a, v, p, q) {
  const theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
  const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1));
  const cosine = 1 / Math.hypot(t, 1);
  const sine = t * cosine;
  /** @type {(row: number[], other: number[], i: number, j: number) => void} */
  const turned = (row, other, i, j) => {
    const [x, y] = [row[i], other[j]];
    row[i] = cosine * x - sine * y;
    other[j] = sine * x + cosine * y;
  };
  for (const row of a) turned(row, row, p, q);
  for (let k = 0; k < a.length; k += 1) turned(a[p], a[q], k, k);
  for (const row of v) turned(row, row, p, q);
}

/**
 * Return the derivatives of a function by central differences: for each parameter, those of
 * all results.
 * @param {(values: number[]) => ArrayLike<number>} results
 * @param {number[]} at
 * @returns {Float64Array[]}
 */
export function slopes(results, at) {
  return at.map((value, k) => {
    const step = STEP * Math.max(1, Math.abs(value));
    const [more, less] = [step, -step].map((shift) =>
      results(at.map((own, j) => (j === k ? own + shift : own))),
    );
    return Float64Array.from(more, (own, i) => (own - less[i]) / (2 * step));
  });
}

/**
 * @param {ArrayLike<number>} a
 * @param {ArrayLike<number>} b
 */
export function product(a, b) {
  let sum = 0;
  for (let k = 0; k < a.length; k += 1) sum += a[k] * b[k];
  return sum;
}

/**
 * Return the parameters of least squares (Levenberg and Marquardt), and the sum of squares;
 * null if no minimum is reached. Residuals beyond a limit count less (Cauchy).
 * @param {(values: number[]) => Float64Array} residuals
 * @param {number[]} start
 * @param {{limit?: number, steps?: number, reached?: number}} [options]
 */
export function leastSquares(
  residuals,
  start,
  { limit = Infinity, steps = STEPS, reached = REACHED } = {},
) {
  const robust = Number.isFinite(limit);
  /** @type {(all: Float64Array) => number} */
  const summed = (all) =>
    robust
      ? all.reduce((sum, value) => sum + limit ** 2 * Math.log1p((value / limit) ** 2), 0)
      : product(all, all);
  let at = start;
  let now = residuals(at);
  let squares = summed(now);
  let damping = 1e-3;
  for (let count = 0; count < steps; count += 1) {
    const columns = slopes(residuals, at);
    if (robust) {
      const root = now.map((value) => 1 / Math.hypot(1, value / limit));
      for (const column of columns) column.forEach((value, k) => (column[k] = value * root[k]));
      now = now.map((value, k) => value * root[k]);
    }
    const right = columns.map((column) => -product(column, now));
    const normal = columns.map((one) => columns.map((other) => product(one, other)));
    let better = false;
    while (!better && damping < 1e12) {
      const damped = normal.map((row, i) =>
        row.map((value, j) => (i === j ? value * (1 + damping) + 1e-300 : value)),
      );
      const step = solved(damped, right);
      const size = Math.hypot(...step) / (1e-3 + Math.hypot(...at));
      const next = at.map((value, k) => value + step[k]);
      const then = residuals(next);
      const sum = summed(then);
      better = sum <= squares;
      if (better) {
        [at, now, squares] = [next, then, sum];
        damping = Math.max(damping / 10, 1e-12);
      } else damping *= 10;
      if (size < reached) return { at, squares };
    }
    if (!better) return { at, squares };
  }
  return robust ? { at, squares } : null;
}
