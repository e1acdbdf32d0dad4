// Contour lines of a grid, by marching squares.

/**
 * Return the segments [x0, y0, x1, y1] of a contour line, in grid steps.
 * Cells with NaN have no segments.
 * @param {ArrayLike<number>} field
 * @param {number} wide
 * @param {number} high
 * @param {number} level
 * @returns {number[][]}
 */
export function segments(field, wide, high, level) {
  const out = [];
  for (let y = 0; y + 1 < high; y += 1) {
    for (let x = 0; x + 1 < wide; x += 1) {
      const at = y * wide + x;
      const a = field[at] - level;
      const b = field[at + 1] - level;
      const c = field[at + wide + 1] - level;
      const d = field[at + wide] - level;
      if (!Number.isFinite(a + b + c + d)) continue;
      /** @type {number[][]} */
      const cuts = [];
      if (a > 0 !== b > 0) cuts.push([x + a / (a - b), y]);
      if (b > 0 !== c > 0) cuts.push([x + 1, y + b / (b - c)]);
      if (d > 0 !== c > 0) cuts.push([x + d / (d - c), y + 1]);
      if (a > 0 !== d > 0) cuts.push([x, y + a / (a - d)]);
      // With four crossings, the value at the middle of the cell decides which are joined.
      if (cuts.length === 4 && a > 0 !== a + b + c + d > 0) cuts.push(...cuts.splice(0, 1));
      for (let k = 0; k + 1 < cuts.length; k += 2) out.push([...cuts[k], ...cuts[k + 1]]);
    }
  }
  return out;
}
