// A close view of a large cloud requests the points of its part, once.

import assert from "node:assert/strict";
import { test } from "node:test";

import { boxInView, Closer, unpackedPoints } from "../../src/amulor/view/page/static/closer.js";

/** Points along x from 0 to 9, and a matrix that shows x from -1 to 1 after a division. */
const LINE = Float32Array.from({ length: 30 }, (_, k) => (k % 3 ? 0 : k / 3));
// prettier-ignore
const scaled = (wide) => [1 / wide, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

test("the box is that of the points in view", () => {
  assert.deepEqual(boxInView(LINE, 10, scaled(3.5)), {
    box: { low: [0, 0, 0], high: [3, 0, 0] },
    share: 0.4,
  });
  // Nothing nearer than the depth of 1 that this matrix gives.
  assert.equal(boxInView(LINE, 10, scaled(3.5), 0.5), null);
  assert.equal(
    boxInView(
      LINE.map(() => 50),
      10,
      scaled(3.5),
    ),
    null,
  );
});

test("a part is requested once, and the whole never", async () => {
  const boxes = [];
  const closer = new Closer(async (box) => boxes.push(box) && 12);
  assert.equal(await closer.look(LINE, 10, scaled(20)), false);
  assert.equal(await closer.look(LINE, 10, scaled(3.5)), true);
  // 4 points and 12 further ones are half as far apart on a surface.
  assert.equal(closer.spacing, 0.5);
  assert.equal(await closer.look(LINE, 10, scaled(2.5)), false);
  assert.equal(boxes.length, 1);
  assert.ok(Math.abs(boxes[0].high[0] - 3.45) < 1e-12);
  // From afar the points are as far apart as before.
  assert.equal(await closer.look(LINE, 10, scaled(20)), true);
  assert.equal(closer.spacing, 1);
  assert.equal(await closer.look(LINE, 10, scaled(4.5)), true);
  assert.equal(boxes.length, 2);
});

test("an answer is positions, values by layer, and colors", () => {
  const buffer = new ArrayBuffer(4 + 4 * 2 * 4 + 6);
  new Uint32Array(buffer, 0, 1)[0] = 2;
  new Float32Array(buffer, 4, 8).set([1, 2, 3, 4, 5, 6, 7, 8]);
  new Uint8Array(buffer, 36).set([9, 8, 7, 6, 5, 4]);
  const { count, position, numbers, colour } = unpackedPoints(buffer, ["height"], true);
  assert.equal(count, 2);
  assert.deepEqual([...position], [1, 2, 3, 4, 5, 6]);
  assert.deepEqual([...numbers.height], [7, 8]);
  assert.deepEqual([...colour], [9, 8, 7, 6, 5, 4]);
});
