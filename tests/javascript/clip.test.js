// A clip box keeps what is between its limits, and says so in the record.

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  boxContent,
  boxFrom,
  boxText,
  inside,
  typedBox,
} from "../../src/amulor/view/page/static/clip.js";

const whole = boxFrom(null);

test("a box without limits has everything inside and no text", () => {
  assert.ok(inside([1e6, -1e6, 0], whole));
  assert.ok(inside([0, 0, 0], null));
  assert.equal(boxText(whole), "");
  assert.equal(boxContent(whole), null);
});

test("typed millimeters limit one axis, and no text removes the limit", () => {
  const box = typedBox(whole, { axis: 2, side: "high", text: "1470" });
  assert.ok(inside([0, 0, 1.4699], box));
  assert.ok(!inside([0, 0, 1.4701], box));
  assert.equal(boxText(box), "forward up to 1470.0 mm");
  const both = typedBox(box, { axis: 2, side: "low", text: "1400" });
  assert.equal(boxText(both), "forward 1400.0 to 1470.0 mm");
  assert.ok(!inside([0, 0, 1.39], both));
  assert.ok(inside([0, 0, 9], typedBox(both, { axis: 2, side: "high", text: " " })));
});

test("limits in the wrong order and other text are refused", () => {
  const box = typedBox(whole, { axis: 0, side: "low", text: "10" });
  assert.throws(() => typedBox(box, { axis: 0, side: "high", text: "10" }), /right must be below/);
  assert.throws(() => typedBox(box, { axis: 0, side: "high", text: "?" }), /Type millimeters/);
});

test("a box survives JSON, missing limits included", () => {
  const box = typedBox(whole, { axis: 1, side: "low", text: "-25.5" });
  const text = JSON.stringify(boxContent(box));
  assert.deepEqual(JSON.parse(text), { low: [null, -0.0255, null], high: [null, null, null] });
  assert.deepEqual(boxFrom(JSON.parse(text)), box);
});
