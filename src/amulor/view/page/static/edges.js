// Steps of a surface between neighboring pixels, as in amulor.imaging.edges.

/** As in amulor.imaging.edges. */
const SIDE = 4;
const BESIDE = [3, 10];
const STEP = 4;
const NEAR = 3;
const SMOOTH = 1e-6;
const TINY = 1e-24;

/**
 * Map of numbers, row by row.
 * @typedef {{high: number, wide: number, values: Float64Array}} Grid
 */

/**
 * @param {Grid} grid
 * @returns {Grid}
 */
function turned({ high, wide, values }) {
  const out = new Float64Array(values.length);
  for (let row = 0; row < high; row += 1)
    for (let column = 0; column < wide; column += 1)
      out[column * high + row] = values[row * wide + column];
  return { high: wide, wide: high, values: out };
}

/**
 * Return sums over some rows above and below each row.
 * @param {Grid} grid
 * @param {number} rows
 */
function summed({ high, wide, values }, rows) {
  const out = new Float64Array(values.length);
  const total = new Float64Array(high + 1);
  for (let column = 0; column < wide; column += 1) {
    for (let row = 0; row < high; row += 1)
      total[row + 1] = total[row] + values[row * wide + column];
    for (let row = 0; row < high; row += 1)
      out[row * wide + column] =
        total[Math.min(row + rows + 1, high)] - total[Math.max(row - rows, 0)];
  }
  return out;
}

/**
 * Return the sizes of steps to the next column in standard errors; 0 if unknown.
 * @param {Grid} distance
 * @param {Grid} variance
 * @param {number} rows
 */
function scores(distance, variance, rows) {
  const { high, wide, values } = distance;
  const valid = values.map((value, at) =>
    Number(Number.isFinite(value) && Number.isFinite(variance.values[at])),
  );
  const number = valid.reduce((sum, one) => sum + one, 0);
  const middle =
    values.reduce((sum, value, at) => (valid[at] ? sum + value : sum), 0) / (number || 1);
  /** @type {(part: Float64Array) => Float64Array} */
  const along = (part) => summed({ high, wide, values: part }, rows);
  const count = along(valid);
  const sum = along(values.map((value, at) => (valid[at] ? value - middle : 0)));
  const mean = sum.map((value, at) => value / Math.max(count[at], 1));
  const spread = along(variance.values.map((value, at) => (valid[at] ? value : 0)));
  const weight = count.map((value, at) =>
    value > 0 ? value ** 2 / Math.max(spread[at], TINY) : 0,
  );
  const out = new Float64Array(values.length);
  for (let row = 0; row < high; row += 1)
    for (let column = 0; column < wide; column += 1)
      out[row * wide + column] = score(mean, weight, row * wide, column, wide);
  return out;
}

/**
 * Return the size of the step behind a column of a line in standard errors: a straight line
 * with a step in it is fitted to the columns on both sides.
 * @param {Float64Array} mean
 * @param {Float64Array} weight
 * @param {number} line
 * @param {number} column
 * @param {number} wide
 */
function score(mean, weight, line, column, wide) {
  let [sum, x, xx, y, xy, yy, columns, half, xh, hy] = new Array(10).fill(0);
  for (let k = 1 - SIDE; k <= SIDE; k += 1) {
    const at = column + k;
    if (at < 0 || at >= wide) continue;
    const w = weight[line + at];
    const own = w * (mean[line + at] - mean[line + column]);
    const place = k - 0.5;
    const side = k > 0 ? 0.5 : -0.5;
    sum += w;
    x += w * place;
    xx += w * place * place;
    y += own;
    xy += own * place;
    yy += (own * own) / Math.max(w, TINY);
    columns += Number(w > 0);
    half += side * w;
    xh += side * w * place;
    hy += side * own;
  }
  sum = Math.max(sum, TINY);
  xy -= (x * y) / sum;
  hy -= (half * y) / sum;
  xx -= x ** 2 / sum;
  xh -= (x * half) / sum;
  const hh = sum / 4 - half ** 2 / sum;
  const determinant = hh * xx - xh ** 2;
  if (!(determinant > 1e-6 * hh * xx)) return 0;
  const step = (hy * xx - xy * xh) / determinant;
  const slope = (xy * hh - hy * xh) / determinant;
  // Understated noise appears in the residuals of the fit.
  const residual = yy - y ** 2 / sum - step * hy - slope * xy;
  const excess = Math.max(residual / Math.max(columns - 3, 1), 1);
  return Math.abs(step) / Math.sqrt((excess * Math.max(xx, TINY)) / determinant);
}

/**
 * @param {Grid} distance
 * @param {Grid} variance
 * @returns {Grid}
 */
function acrossColumns(distance, variance) {
  const { high, wide } = distance;
  const [few, many] = BESIDE.map((rows) => scores(distance, variance, rows));
  const best = few.map((value, at) => Math.max(value, many[at]));
  const values = best.map((value, at) => {
    const column = at % wide;
    const near = best.subarray(
      at - Math.min(column, NEAR),
      at + Math.min(wide - 1 - column, NEAR) + 1,
    );
    return Number(value > STEP && near.every((other) => value >= other));
  });
  return { high, wide, values };
}

/**
 * Return whether the surface steps from each pixel to the next column, and to the next row.
 * @param {Grid} distance
 * @param {Grid} variance
 */
export function stepsOf(distance, variance) {
  const { high, wide } = distance;
  const least = variance.values.map((value, at) =>
    Math.max(value, (SMOOTH * distance.values[at]) ** 2, TINY),
  );
  const errors = { high, wide, values: least };
  return {
    across: acrossColumns(distance, errors).values,
    down: turned(acrossColumns(turned(distance), turned(errors))).values,
  };
}
