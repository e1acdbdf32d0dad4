// Density of lines from a vehicle, and the picture that shows them.

import assert from "node:assert/strict";
import { test } from "node:test";

import { densityOf, fitting, numbersOf } from "../../src/amulor/view/page/static/vehicle.js";

const STATE = {
  lines: 12,
  without_pose: 0,
  between: 14e-3,
  wanted: 5e-3,
  speed: 0.28,
  planned_speed: 0.1,
  density: 7140,
  wanted_density: 20000,
  area: 0.25,
};

test("lines have one of three densities", () => {
  assert.equal(densityOf(1.1), "as wanted");
  assert.equal(densityOf(0.8), "as wanted");
  assert.equal(densityOf(0.6), "sparse");
  assert.equal(densityOf(0.2), "too sparse");
  assert.equal(densityOf(null), "unknown");
});

test("all places lie inside of the picture, and north is up", () => {
  const size = { width: 200, height: 100 };
  const { at, scale } = fitting(
    [
      [431, 87],
      [433, 88],
    ],
    size,
  );
  const [x, y] = at([431, 87]);
  assert.ok(x >= 0 && y <= 100);
  assert.ok(at([431, 88])[1] < y);
  // One meter is as long across as along.
  assert.ok(Math.abs(at([432, 87])[0] - x - scale) < 1e-9);
  assert.ok(Math.abs(y - at([431, 88])[1] - scale) < 1e-9);
});

test("a single place is in the middle", () => {
  assert.deepEqual(fitting([[5, 5]], { width: 200, height: 100 }).at([5, 5]), [100, 50]);
});

test("numbers state what was wanted, and mark what falls short", () => {
  const rows = Object.fromEntries(numbersOf(STATE).map((row) => [row.name, row]));
  assert.equal(rows["between lines"].text, "14 mm, 5 wanted");
  assert.ok(rows["between lines"].wrong);
  assert.equal(rows["points per m²"].text, "7,140, 20,000 wanted");
  assert.ok(rows["points per m²"].wrong);
  assert.equal(rows.speed.text, "0.28 m/s, 0.1 planned");
  assert.equal(rows["without a pose"], undefined);
});

test("unknown numbers are left out", () => {
  const nothing = { ...STATE, speed: null, between: null, density: null, area: null };
  assert.deepEqual(
    numbersOf(nothing).map(({ name }) => name),
    ["lines"],
  );
});
