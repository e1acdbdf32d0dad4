// Clip box: the part of space that is drawn and measured.

import { $, made, ratioOf, spotOn } from "./dom.js";
import { dot, halo, polyline } from "./marks.js";
import { short } from "./text.js";

/** @typedef {import("./camera.js").Point} Point */
/** @typedef {{low: Point, high: Point}} Box limits [m]; infinite where there is none */

const AXES = ["right", "down", "forward"];
/** @type {("low" | "high")[]} */
const SIDES = ["low", "high"];
/** Distance from a handle within which the pointer takes it [page pixel]. */
const NEAR = 14;

/** @returns {Box} */
const whole = () => ({
  low: [-Infinity, -Infinity, -Infinity],
  high: [Infinity, Infinity, Infinity],
});

/**
 * Return whether a point is in a box; without a box, every point is.
 * @param {ArrayLike<number>} point
 * @param {Box | null} box
 */
export function inside(point, box) {
  return !box || [0, 1, 2].every((k) => point[k] >= box.low[k] && point[k] <= box.high[k]);
}

/**
 * Return a box in which one limit is replaced by typed millimeters; no text is no limit.
 * @param {Box} box
 * @param {{axis: number, side: "low" | "high", text: string}} typed
 * @returns {Box}
 */
export function typedBox(box, { axis, side, text }) {
  const end = side === "low" ? -Infinity : Infinity;
  const value = text.trim() === "" ? end : Number(text) / 1e3;
  if (Number.isNaN(value)) throw new Error("Type millimeters, or nothing for no limit.");
  /** @type {Box} */
  const next = { low: [...box.low], high: [...box.high] };
  next[side][axis] = value;
  if (!(next.low[axis] < next.high[axis]))
    throw new Error(`The lower limit of ${AXES[axis]} must be below the upper one.`);
  return next;
}

/**
 * Return the limits of a box as text; empty for a box without limits.
 * @param {Box | null} box
 */
export function boxText(box) {
  if (!box) return "";
  const text = (/** @type {number} */ value) => short(value * 1e3, 5);
  return AXES.map((name, k) => {
    const [low, high] = [box.low[k], box.high[k]];
    if (Number.isFinite(low) && Number.isFinite(high))
      return `${name} ${text(low)} to ${text(high)} mm`;
    if (Number.isFinite(low)) return `${name} from ${text(low)} mm`;
    return Number.isFinite(high) ? `${name} up to ${text(high)} mm` : "";
  })
    .filter(Boolean)
    .join(", ");
}

/**
 * Return the box with finite numbers for JSON and for the GPU; null for a missing limit.
 * @param {Box | null} box
 */
export function boxContent(box) {
  if (!boxText(box)) return null;
  const listed = (/** @type {Point} */ ends) =>
    ends.map((value) => (Number.isFinite(value) ? value : null));
  return box && { low: listed(box.low), high: listed(box.high) };
}

/**
 * Return a box from its JSON content.
 * @param {{low: (number | null)[], high: (number | null)[]} | null | undefined} content
 */
export function boxFrom(content) {
  const box = whole();
  for (const side of SIDES)
    content?.[side].forEach((value, k) => {
      if (value !== null) box[side][k] = value;
    });
  return box;
}

/** Panel of the clip box, with six number fields and handles in the 3-D view. */
export class ClipBox {
  /** @type {Box} */
  #box = whole();
  /** Extent of the surface, where the box has no limit. @type {Box} */
  #extent = whole();
  #changed;

  constructor(changed) {
    this.#changed = changed;
    $("clip-fields").replaceChildren(...AXES.flatMap((name, axis) => this.#fields(name, axis)));
    $("clip-whole").addEventListener("click", () => this.set(whole()));
  }

  /** Present box; null while the panel is closed or without limits. */
  get box() {
    return $("clip-panel").hidden || !boxText(this.#box) ? null : this.#box;
  }

  #fields(name, axis) {
    const inputs = SIDES.map((side) => {
      const field = made("input", {
        type: "number",
        step: "1",
        id: `clip-${side}-${axis}`,
        ariaLabel: `${side === "low" ? "Lower" : "Upper"} limit of ${name} [mm]`,
      });
      field.addEventListener("change", () => this.#typed(field, { axis, side }));
      return field;
    });
    return [made("span", {}, name, " ", inputs[0], " to ", inputs[1])];
  }

  #typed(field, { axis, side }) {
    const text = field.validity.badInput ? "?" : field.value;
    try {
      this.set(typedBox(this.#box, { axis, side, text }));
      $("clip-note").textContent = "";
    } catch (error) {
      $("clip-note").textContent = error.message;
      field.ariaInvalid = "true";
    }
  }

  /** @param {Box} box */
  set(box) {
    this.#box = box;
    for (const axis of [0, 1, 2])
      for (const side of SIDES) {
        const field = $(`clip-${side}-${axis}`);
        const value = box[side][axis];
        field.value = Number.isFinite(value) ? (value * 1e3).toFixed(1) : "";
        field.placeholder = (this.#extent[side][axis] * 1e3).toFixed(1);
        field.ariaInvalid = "false";
      }
    this.#changed();
  }

  /**
   * Open or close the panel.
   * @param {Point[]} places of the surface
   */
  toggle(places) {
    const opens = $("clip-panel").hidden;
    if (opens && places.length) {
      const ends = (/** @type {(...all: number[]) => number} */ end) =>
        /** @type {Point} */ ([0, 1, 2].map((k) => end(...places.map((place) => place[k]))));
      this.#extent = { low: ends(Math.min), high: ends(Math.max) };
    }
    this.show(opens);
  }

  /** @param {boolean} opens */
  show(opens) {
    $("clip-panel").hidden = !opens;
    for (const name of ["aria-pressed", "aria-expanded"])
      $("clip").setAttribute(name, String(opens));
    this.set(this.#box);
  }

  #end(side, k) {
    const value = this.#box[side][k];
    return Number.isFinite(value) ? value : this.#extent[side][k];
  }

  /** Centers of the six sides. */
  #handles() {
    const middle = [0, 1, 2].map((k) => (this.#end("low", k) + this.#end("high", k)) / 2);
    return [0, 1, 2].flatMap((axis) =>
      SIDES.map((side) => {
        const place = /** @type {Point} */ ([...middle]);
        place[axis] = this.#end(side, axis);
        return { axis, side, place };
      }),
    );
  }

  /** Draw edges and handles of the open box. */
  draw(ctx, spotOf, ratio, colours) {
    if ($("clip-panel").hidden) return;
    const corner = (bits) =>
      /** @type {Point} */ ([0, 1, 2].map((k) => this.#end(SIDES[(bits >> k) & 1], k)));
    for (let bits = 0; bits < 8; bits += 1)
      for (const k of [0, 1, 2]) {
        if ((bits >> k) & 1) continue;
        const ends = [corner(bits), corner(bits | (1 << k))].map(spotOf);
        if (ends.every(Boolean)) halo(ctx, 0.8 * ratio, colours, () => polyline(ctx, ends));
      }
    for (const { place } of this.#handles()) {
      const spot = spotOf(place);
      if (spot) dot(ctx, spot, 5 * ratio, colours, true);
    }
  }

  /** Return a function that moves the side under the pointer; null if there is none. */
  grab(canvas, spotOf, event) {
    if ($("clip-panel").hidden) return null;
    const start = spotOn(canvas, event);
    const near = NEAR * ratioOf(canvas);
    const away = ({ place }) => {
      const spot = spotOf(place);
      return spot ? Math.hypot(spot[0] - start[0], spot[1] - start[1]) : Infinity;
    };
    const [handle] = this.#handles().sort((a, b) => away(a) - away(b));
    if (!(away(handle) < near)) return null;
    return this.#puller(canvas, spotOf, handle, start);
  }

  #puller(canvas, spotOf, { axis, side, place }, start) {
    const step = (this.#end("high", axis) - this.#end("low", axis)) / 10;
    const further = /** @type {Point} */ ([...place]);
    further[axis] += step;
    const [from, to] = [spotOf(place), spotOf(further)];
    if (!from || !to) return null;
    const along = [(to[0] - from[0]) / step, (to[1] - from[1]) / step];
    const square = along[0] ** 2 + along[1] ** 2;
    return (event) => {
      const spot = spotOn(canvas, event);
      const moved = (spot[0] - start[0]) * along[0] + (spot[1] - start[1]) * along[1];
      const text = String((place[axis] + moved / Math.max(square, 1e-9)) * 1e3);
      try {
        this.set(typedBox(this.#box, { axis, side, text }));
      } catch {
        // A side stops at the opposite one.
      }
    };
  }
}
