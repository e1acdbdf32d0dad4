// Lines of equal value against fields whose lines are known.

import assert from "node:assert/strict";
import { test } from "node:test";

import { segments } from "../../src/amulor/view/page/static/contours.js";

function fieldOf(wide, high, value) {
  return Float64Array.from({ length: wide * high }, (_, at) =>
    value(at % wide, Math.floor(at / wide)),
  );
}

test("a plane has one straight line, in each cell that it crosses", () => {
  const found = segments(
    fieldOf(6, 4, (x, y) => x + 0.25 * y),
    6,
    4,
    2.3,
  );
  // It crosses the three rows of cells, and a column within the second of them.
  assert.equal(found.length, 4);
  let length = 0;
  for (const [x0, y0, x1, y1] of found) {
    for (const [x, y] of [
      [x0, y0],
      [x1, y1],
    ]) {
      assert.ok(Math.abs(x + 0.25 * y - 2.3) < 1e-12, `${x}, ${y}`);
    }
    length += Math.hypot(x1 - x0, y1 - y0);
  }
  assert.ok(Math.abs(length - Math.hypot(0.75, 3)) < 1e-12);
});

test("the lines of a hill are closed and go around it", () => {
  const size = 41;
  const middle = 20;
  const found = segments(
    fieldOf(size, size, (x, y) => Math.hypot(x - middle, y - middle)),
    size,
    size,
    12.4,
  );
  const ends = new Map();
  let length = 0;
  for (const [x0, y0, x1, y1] of found) {
    length += Math.hypot(x1 - x0, y1 - y0);
    for (const end of [
      [x0, y0],
      [x1, y1],
    ]) {
      assert.ok(Math.abs(Math.hypot(end[0] - middle, end[1] - middle) - 12.4) < 0.02);
      const key = end.map((part) => part.toFixed(9)).join();
      ends.set(key, (ends.get(key) ?? 0) + 1);
    }
  }
  // Closed: each end belongs to two segments.
  assert.deepEqual(new Set(ends.values()), new Set([2]));
  assert.ok(Math.abs(length / (2 * Math.PI * 12.4) - 1) < 2e-3, `${length}`);
});

test("no line goes through a cell with a corner that is no number", () => {
  const field = fieldOf(5, 5, (x) => x);
  const all = segments(field, 5, 5, 1.5);
  assert.equal(all.length, 4);
  field[2 * 5 + 1] = NaN;
  const left = segments(field, 5, 5, 1.5);
  // The corner belongs to two of the four cells that the line crosses.
  assert.deepEqual(
    left.map(([, y0, , y1]) => Math.min(y0, y1)),
    [0, 3],
  );
});

test("at a saddle, corners on the side of the middle are joined", () => {
  // High at two opposite corners: with a high middle, the low corners are cut off.
  const cut = (high) => segments(Float64Array.from([high, 0, 0, high]), 2, 2, 1);
  const near = (segment, corner) =>
    Math.max(
      Math.hypot(segment[0] - corner[0], segment[1] - corner[1]),
      Math.hypot(segment[2] - corner[0], segment[3] - corner[1]),
    ) < 1;
  const around = (found, corners) => corners.every((at) => found.some((one) => near(one, at)));
  const high = cut(3);
  assert.equal(high.length, 2);
  assert.ok(
    around(high, [
      [1, 0],
      [0, 1],
    ]),
  );
  const low = cut(1.5);
  assert.equal(low.length, 2);
  assert.ok(
    around(low, [
      [0, 0],
      [1, 1],
    ]),
  );
});
