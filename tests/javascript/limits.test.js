// Typed limits of color scales: what is refused, and what the address of the page keeps.

import assert from "node:assert/strict";
import { test } from "node:test";

import { limitsFrom, limitsText, typedLimits } from "../../src/amulor/view/page/static/limits.js";

const METERS = { unit: "m", factor: 1 };
const MILLIMETERS = { unit: "mm", factor: 1e3 };
const typed = (limits, side, text, unit = METERS, kind = "range") =>
  typedLimits(limits, { side, text, kind, unit });

test("a typed limit replaces one of the two, in the unit of the scale", () => {
  assert.deepEqual(typed([1, 2], "low", "1.5"), [1.5, 2]);
  assert.deepEqual(typed([0.001, 0.002], "high", " 5 ", MILLIMETERS), [0.001, 0.005]);
});

test("limits of a signed map stay symmetric, so that gray is 0", () => {
  for (const side of ["low", "high"])
    for (const text of ["-4", "4"])
      assert.deepEqual(typed([-0.001, 0.001], side, text, MILLIMETERS, "signed"), [-0.004, 0.004]);
  assert.throws(() => typed([-1, 1], "low", "0", METERS, "signed"), /Not 0/);
});

test("text without a number is refused with the unit and an example", () => {
  for (const text of ["", "abc", "1e999", "Infinity"])
    assert.throws(() => typed([0.001, 0.002], "high", text, MILLIMETERS), {
      message: "Type a number in mm, such as 2.000.",
    });
});

test("limits that are equal or in the wrong order are refused in one line", () => {
  assert.throws(() => typed([1, 1.5], "low", "1.6"), {
    message: "1.6000 m is not below 1.5000 m.",
  });
  assert.throws(() => typed([1, 1.5], "high", "0.5"), /: 0.50000 m is not above 1.0000 m.$/);
  // These differ by less than single precision resolves.
  assert.throws(() => typed([1, 1.5], "low", "1.49999999999"), /is not below/);
});

test("limits return from the address as they were typed", () => {
  const own = new Map([
    ["range", [1.41, 1.52]],
    ["bias", [-3e-7, 3e-7]],
  ]);
  assert.deepEqual(limitsFrom(limitsText(own)), own);
  assert.equal(limitsFrom("").size, 0);
});

test("entries of the address that are no limits are ignored", () => {
  const text =
    "range:2:1,wrong:0:,flags:a:b,:1:2,amplitude:0:1:2,uncertainty:0:0.01,bias:0:Infinity";
  assert.deepEqual(limitsFrom(text), new Map([["uncertainty", [0, 0.01]]]));
});
