// The number of drawn points follows the time of a frame, within its limits.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Pace } from "../../src/amulor/view/page/static/turning.js";

test("slow frames draw fewer points in proportion, fast ones more", () => {
  const pace = new Pace(100000, { fewest: 20000, most: 200000 });
  pace.paced(80);
  assert.equal(pace.count, 50000);
  pace.paced(30);
  assert.equal(pace.count, 50000);
  pace.paced(10);
  assert.equal(pace.count, 75000);
});

test("the number of points stays within its limits", () => {
  const pace = new Pace(100000, { fewest: 20000, most: 200000 });
  pace.paced(70000);
  assert.equal(pace.count, 20000);
  for (let k = 0; k < 20; k += 1) pace.paced(5);
  assert.equal(pace.count, 200000);
});
