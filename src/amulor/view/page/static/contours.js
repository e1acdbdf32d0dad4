// Lines of equal value in a grid: marching squares.

/**
 * Return segments [x0, y0, x1, y1], in steps of the grid, where a field has a level.
 * Cells with a value that is no number have none.
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
      // Of four cuts the ones that the middle of the cell does not part belong together.
      if (cuts.length === 4 && a > 0 !== a + b + c + d > 0) cuts.push(...cuts.splice(0, 1));
      for (let k = 0; k + 1 < cuts.length; k += 2) out.push([...cuts[k], ...cuts[k + 1]]);
    }
  }
  return out;
}
