// The map and the 3-D view lie so that the map is drawn as large as possible.

import assert from "node:assert/strict";
import { test } from "node:test";

import { splitOf } from "../../src/amulor/view/page/static/stage.js";

test("a wide scan is above its 3-D view, a tall one beside it", () => {
  // A stage of 900 x 620: side by side, a map has 445 x 620; stacked, 900 x 305.
  const size = { width: 900, height: 620 };
  // Without the axes, 10 parts of a wide scan share 847 instead of 392 pixels.
  assert.equal(splitOf({ across: 10, down: 1 }, size), "column");
  assert.equal(splitOf({ across: 1, down: 2 }, size), "row");
  // The unit of the shape does not matter.
  assert.equal(splitOf({ across: 1000, down: 100 }, size), "column");
});

test("the same scan is stacked in a tall window and side by side in a low one", () => {
  const shape = { across: 5, down: 2 };
  assert.equal(splitOf(shape, { width: 740, height: 900 }), "column");
  assert.equal(splitOf(shape, { width: 1000, height: 330 }), "row");
});
