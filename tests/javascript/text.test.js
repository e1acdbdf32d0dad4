// Numbers in words.

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  clockIn,
  duration,
  scaled,
  short,
  ticks,
  withError,
  withUnit,
} from "../../src/amulor/view/page/static/text.js";

test("an uncertainty has two digits, and the value as many places", () => {
  assert.equal(withError(1.23456, 0.0123, "m"), "1235 ± 12 mm");
  assert.equal(withError(0.5, 0.00012345, "m"), "500.00 ± 0.12 mm");
  assert.equal(withError(12.3456, 0.0123, "m"), "12.346 ± 0.012 m");
  assert.equal(withError(-0.02, 0.001, "m"), "−20.0 ± 1.0 mm");
  assert.equal(withError(Math.PI / 2, Math.PI / 180, "rad"), "(90.0 ± 1.0)°");
  assert.equal(withError(0.0004, 0.00002, "m2"), "400 ± 20 mm²");
  assert.equal(withError(3.42e-3, 0.13e-3, "m3"), "3.42 ± 0.13 dm³");
  assert.equal(withError(19.4e-6, 1.8e-6, "m3"), "19.4 ± 1.8 cm³");
  assert.equal(withError(0.912, 0.034, "1"), "0.912 ± 0.034");
});

test("without an uncertainty the value stands alone", () => {
  assert.equal(withError(1.5, NaN, "m"), "1.500 m");
  assert.equal(withError(1.5, 0, "m"), "1.500 m");
  assert.equal(withUnit(null, "m"), "–");
  assert.equal(withUnit(Infinity, "V"), "–");
});

test("a unit fits the size", () => {
  const units = (unit, ...sizes) => sizes.map((size) => scaled(size, unit).unit);
  assert.deepEqual(units("m", 2, 0.2, 0, 0.0002), ["m", "mm", "mm", "µm"]);
  assert.deepEqual(units("V", 2, 0.02, 2e-5, 2e-8, 2e-12), ["V", "mV", "µV", "nV", "nV"]);
  assert.deepEqual(units("m2", 2, 0.02, 2e-4), ["m²", "cm²", "mm²"]);
  assert.equal(withUnit(0.0234, "V", 3), "23.4 mV");
  assert.equal(withUnit(Math.PI, "rad"), "180.0°");
});

test("few digits, and an exponent only where zeros would be many", () => {
  assert.equal(short(0), "0");
  assert.equal(short(1234.56), "1235");
  assert.equal(short(-0.0012345, 3), "−0.00123");
  assert.equal(short(1.2e-7, 2), "1.2e-7");
  assert.equal(short(NaN), "–");
});

test("ticks are round, even, inside, and about as many as wanted", () => {
  let seed = 1;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let k = 0; k < 500; k += 1) {
    const low = (random() - 0.5) * 10 ** Math.floor(random() * 8 - 4);
    const span = random() * 10 ** Math.floor(random() * 8 - 4) + 1e-6;
    const wanted = 2 + Math.floor(random() * 8);
    const { values, step, places } = ticks(low, low + span, wanted);
    const digits = step / 10 ** Math.floor(Math.log10(step) + 1e-9);
    assert.ok(
      [1, 2, 5].some((digit) => Math.abs(digits - digit) < 1e-6),
      `step ${step}`,
    );
    assert.ok(values.length <= wanted + 1, `${values.length} ticks for ${wanted}`);
    assert.ok(span / step >= wanted / 2.6, `step ${step} of ${span}`);
    for (const value of values) {
      assert.ok(value >= low - 1e-6 * span && value <= low + span * (1 + 1e-6));
      assert.ok(Math.abs(value / step - Math.round(value / step)) < 1e-6, `${value} by ${step}`);
      assert.ok(Math.abs(Number(value.toFixed(places)) - value) < step * 1e-6);
    }
  }
  assert.ok(ticks(-0.689, 0.689, 8).values.some((value) => Object.is(value, 0)));
  assert.deepEqual(ticks(3, 3).values, [3]);
});

test("seconds as a person says them", () => {
  assert.equal(duration(59.6), "1 min 00 s");
  assert.equal(duration(12), "12 s");
  assert.equal(duration(3725), "1 h 02 min");
  assert.equal(duration(-3), "0 s");
  assert.equal(duration(NaN), "–");
});

test("the end of a scan is a time of day, of another day with its name", () => {
  const evening = new Date(2026, 10, 25, 23, 30, 0);
  assert.equal(clockIn(90, evening), "23:31");
  assert.equal(clockIn(3600, evening), "Thu 00:30");
});
