// Measurements in a saved page, which has no server: as amulor.view.page.measuring.

import { boxFrom, inside } from "./clip.js";
import { fit } from "./fits.js";
import { angle, area, distance, height } from "./geometry.js";
import { halfProfileOf } from "./round_objects.js";
import { volume } from "./volumes.js";

/** @typedef {[number, number]} Pixel row and column of the scan */

/** Largest number of pixels of a rectangle; more are thinned evenly. */
const MOST_PIXELS = 1500;
/** Largest number of pixels of a volume. */
const MOST_OF_VOLUME = 250000;
/** Largest number of pixels of a half-profile. */
const MOST_OF_PROFILE = 3200;
const FITS = ["plane", "circle", "sphere", "cylinder"];
/** Flags of pixels that belong to no surface. */
const OFF_SURFACE = ["mixed", "outlier"];

/**
 * Return the drawn pixels of a rectangle, thinned evenly.
 * @param {number[]} region
 * @param {number} stride
 * @param {number} [most]
 * @returns {Pixel[]}
 */
export function pixelsIn(region, stride, most = MOST_PIXELS) {
  const [top, left, bottom, right] = region;
  const line = (/** @type {number} */ first, /** @type {number} */ last) => {
    const from = Math.ceil(first / stride) * stride;
    const count = Math.max(Math.floor((last - from) / stride) + 1, 0);
    return Array.from({ length: count }, (_, k) => from + k * stride);
  };
  const [rows, columns] = [line(top, bottom), line(left, right)];
  const step = Math.max(1, Math.ceil(Math.sqrt((rows.length * columns.length) / most)));
  /** @type {(all: number[]) => number[]} */
  const thinned = (all) => all.filter((_, k) => k % step === 0);
  return thinned(rows).flatMap((row) =>
    thinned(columns).map((column) => /** @type {Pixel} */ ([row, column])),
  );
}

/** Return whether a pixel is on a surface, by its range and flags. */
function usableIn(scene) {
  const stray = scene.flags
    .filter(({ name }) => OFF_SURFACE.includes(name))
    .reduce((bits, { mask }) => bits | mask, 0);
  return (/** @type {Pixel} */ pixel) =>
    Number.isFinite(scene.value("range", ...pixel)) && !(scene.value("flags", ...pixel) & stray);
}

/** Return whether the point of a pixel is in the clip box. */
function clippedBy(scene, clip) {
  const box = boxFrom(clip);
  return (/** @type {Pixel} */ [row, column]) => {
    const range = scene.value("range", row, column);
    return !clip || (Number.isFinite(range) && inside(scene.beams.point(row, column, range), box));
  };
}

/** Return the volume over a plane fitted to the pixels of another rectangle. */
function volumeIn(scene, region, base, clip) {
  const { stride } = scene;
  const all = pixelsIn(region, stride, MOST_OF_VOLUME);
  const within = clippedBy(scene, clip);
  const kept = all.filter(within);
  if (!kept.length) throw new Error("The rectangle has no pixel in the clip box; enlarge it.");
  const ends = [0, 1].map((k) => {
    const line = kept.map((pixel) => pixel[k]);
    return [line.reduce((a, b) => Math.min(a, b)), line.reduce((a, b) => Math.max(a, b))];
  });
  const pixels = all.filter((pixel) =>
    ends.every(([low, high], k) => low <= pixel[k] && pixel[k] <= high),
  );
  const wide = pixels.filter(([row]) => row === pixels[0][0]).length;
  const high = pixels.length / wide;
  const spacing = ends.map(([low, end], k) => (end - low) / Math.max([high, wide][k] - 1, 1));
  const usable = usableIn(scene);
  const window = { pixels, wide, usable: pixels.map(usable), inside: pixels.map(within) };
  return volume(scene, window, pixelsIn(base, stride).filter(usable), Math.max(...spacing));
}

/** Compute a measurement from its picks in the page. */
export async function measuredHere(scene, tool, { picks, region, base, clip, reach }) {
  const needed = scene.layers.filter(
    ({ name, kind }) => kind === "hidden" || ["range", "uncertainty", "flags"].includes(name),
  );
  await Promise.all(needed.map(({ name }) => scene.load(name)));
  if (tool.kind === "volume") return volumeIn(scene, region, base, clip);
  if (tool.axis) return height(scene, picks, tool.axis, reach);
  const round = tool.kind === "profile";
  if (round || FITS.includes(tool.kind)) {
    const most = round ? MOST_OF_PROFILE : MOST_PIXELS;
    const [usable, within] = [usableIn(scene), clippedBy(scene, clip)];
    const pixels = (region ? pixelsIn(region, scene.stride, most) : picks).filter(
      (pixel) => usable(pixel) && within(pixel),
    );
    return round ? halfProfileOf(scene, pixels) : fit(scene, tool.kind, pixels);
  }
  return { distance, angle, area }[tool.kind](scene, picks, reach);
}
