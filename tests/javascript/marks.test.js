// Marks are seen on all that the maps show, and the marking color is in none of them.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import { flagColour, INK, MAPS, table } from "../../src/amulor/view/page/static/colour.js";

const STYLE = readFileSync(
  new URL("../../src/amulor/view/page/static/page.css", import.meta.url),
  "utf-8",
);
const THEMES = [":root {", ':root[data-theme="dark"] {', ':root[data-theme="contrast"] {'].map(
  (head) => {
    const block = STYLE.slice(STYLE.indexOf(head), STYLE.indexOf("}", STYLE.indexOf(head)));
    return Object.fromEntries(
      [...block.matchAll(/--([\w-]+): (#[0-9a-f]{6})/g)].map((found) => [
        found[1],
        bytes(found[2]),
      ]),
    );
  },
);

function bytes(hex) {
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

function linear(colour) {
  return colour
    .map((part) => part / 255)
    .map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
}

/** Contrast of two colours, as WCAG 2 defines it. */
function contrast(one, other) {
  const [high, low] = [one, other]
    .map((colour) => linear(colour))
    .map(([red, green, blue]) => 0.2126 * red + 0.7152 * green + 0.0722 * blue + 0.05)
    .sort((a, b) => b - a);
  return high / low;
}

/** Lightness and two chromaticities of a colour (CIELAB, D65). */
function lab(colour) {
  const [red, green, blue] = linear(colour);
  const [x, y, z] = [
    (0.4124 * red + 0.3576 * green + 0.1805 * blue) / 0.9505,
    0.2126 * red + 0.7152 * green + 0.0722 * blue,
    (0.0193 * red + 0.1192 * green + 0.9505 * blue) / 1.089,
  ].map((part) => (part > 0.008856 ? Math.cbrt(part) : 7.787 * part + 16 / 116));
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

/** All colours that a map or a stage may have behind a mark. */
function shown(theme) {
  const maps = MAPS.flatMap((name) => {
    const all = table(name);
    return Array.from({ length: 256 }, (_, k) => [...all.subarray(4 * k, 4 * k + 3)]);
  });
  const flags = [...Object.values(INK), flagColour("missing"), flagColour("no target"), "#2c7f62"];
  return [...maps, ...flags.map(bytes), theme.stage];
}

test("a mark contrasts with every color of the maps, flags and stages above 4.5", () => {
  for (const theme of THEMES) {
    const found = shown(theme).map((colour) =>
      Math.max(contrast(theme.mark, colour), contrast(theme.under, colour)),
    );
    assert.ok(found.length > 1000);
    assert.ok(Math.min(...found) > 4.5, `${Math.min(...found)}`);
    // What is chosen has its color within the white of the mark.
    assert.ok(contrast(theme.chosen, theme.mark) > 4.5);
  }
});

test("the marking color is none that data have", () => {
  for (const theme of THEMES) {
    const own = lab(theme.chosen);
    const least = Math.min(
      ...shown(theme).map((colour) => Math.hypot(...lab(colour).map((part, k) => part - own[k]))),
    );
    assert.ok(least > 30, `${least}`);
  }
});

test("text of the high-contrast theme has a contrast above 7, as WCAG 2 asks for level AAA", () => {
  const theme = THEMES[2];
  for (const text of [theme.ink, theme.soft, theme.accent, theme.warn])
    for (const behind of [theme.card, theme.ground, theme.stage, theme["accent-soft"]])
      assert.ok(contrast(text, behind) > 7, `${text} on ${behind}`);
  assert.ok(contrast(theme.warn, theme["warn-soft"]) > 7);
  // Frames of fields and panels have 4.5.
  assert.ok(contrast(theme.line, theme.card) > 4.5);
});
