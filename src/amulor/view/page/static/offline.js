// Measurements in a saved page, which has no server: as amulor.view.page.measuring.

import { boxFrom, inside } from "./clip.js";
import { fit } from "./fits.js";
import { angle, area, distance, height } from "./geometry.js";

/** @typedef {[number, number]} Pixel row and column of the scan */

/** Largest number of pixels of a rectangle; more are thinned evenly. */
const MOST_PIXELS = 1500;
const FITS = ["plane", "circle", "sphere", "cylinder"];
/** Flags of pixels that belong to no surface. */
const OFF_SURFACE = ["mixed", "outlier"];

/** Return why a tool does not work without a server; empty if it does. */
export function needsServer(kind) {
  return ["volume", "profile"].includes(kind)
    ? "Needs the server: open the file by amulor view"
    : "";
}

/**
 * Return the drawn pixels of a rectangle, thinned evenly.
 * @param {number[]} region
 * @param {number} stride
 * @returns {Pixel[]}
 */
export function pixelsIn([top, left, bottom, right], stride) {
  const line = (/** @type {number} */ first, /** @type {number} */ last) => {
    const from = Math.ceil(first / stride) * stride;
    const count = Math.max(Math.floor((last - from) / stride) + 1, 0);
    return Array.from({ length: count }, (_, k) => from + k * stride);
  };
  const [rows, columns] = [line(top, bottom), line(left, right)];
  const step = Math.max(1, Math.ceil(Math.sqrt((rows.length * columns.length) / MOST_PIXELS)));
  /** @type {(all: number[]) => number[]} */
  const thinned = (all) => all.filter((_, k) => k % step === 0);
  return thinned(rows).flatMap((row) =>
    thinned(columns).map((column) => /** @type {Pixel} */ ([row, column])),
  );
}

/** Return the pixels on a surface within the clip box. */
function onSurface(scene, pixels, box) {
  const stray = scene.flags
    .filter(({ name }) => OFF_SURFACE.includes(name))
    .reduce((bits, { mask }) => bits | mask, 0);
  return pixels.filter(([row, column]) => {
    const range = scene.value("range", row, column);
    if (!Number.isFinite(range) || scene.value("flags", row, column) & stray) return false;
    return inside(scene.beams.point(row, column, range), box);
  });
}

/** Compute a measurement from its picks in the page. */
export async function measuredHere(scene, tool, { picks, region, clip, reach }) {
  const needed = scene.layers.filter(
    ({ name, kind }) => kind === "hidden" || ["range", "uncertainty", "flags"].includes(name),
  );
  await Promise.all(needed.map(({ name }) => scene.load(name)));
  if (tool.axis) return height(scene, picks, tool.axis, reach);
  if (FITS.includes(tool.kind)) {
    const pixels = onSurface(scene, region ? pixelsIn(region, scene.stride) : picks, boxFrom(clip));
    return fit(scene, tool.kind, pixels);
  }
  return { distance, angle, area }[tool.kind](scene, picks, reach);
}
