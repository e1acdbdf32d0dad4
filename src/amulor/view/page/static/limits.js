// Typed limits of the color scales, kept in the address of the page and in saved pages.

import { $ } from "./dom.js";
import { short, ticks } from "./text.js";

/** @typedef {[number, number]} Limits */
/** @typedef {{unit: string, factor: number}} Unit */

/**
 * Return limits in which one is replaced by typed text. Limits of signed maps are symmetric.
 * @param {Limits} limits
 * @param {{side: "low" | "high", text: string, kind: string, unit: Unit}} typed
 * @returns {Limits}
 */
export function typedLimits([low, high], { side, text, kind, unit }) {
  const value = text.trim() === "" ? NaN : Number(text) / unit.factor;
  const withUnit = (/** @type {number} */ size) =>
    `${short(size * unit.factor, 5)} ${unit.unit}`.trim();
  if (!Number.isFinite(value))
    throw new Error(
      `Type a number${unit.unit && ` in ${unit.unit}`}, such as ${short((side === "low" ? low : high) * unit.factor, 4)}.`,
    );
  if (kind === "signed") {
    if (value === 0) throw new Error("Not 0: these limits are symmetric.");
    return [-Math.abs(value), Math.abs(value)];
  }
  const [from, to] = side === "low" ? [value, high] : [low, value];
  // The GPU compares numbers of single precision.
  if (!(Math.fround(from) < Math.fround(to)))
    throw new Error(
      side === "low"
        ? `${withUnit(from)} is not below ${withUnit(to)}.`
        : `${withUnit(to)} is not above ${withUnit(from)}.`,
    );
  return [from, to];
}

/**
 * Return typed limits of maps as text for an address, in SI units.
 * @param {Map<string, number[]>} own
 */
export function limitsText(own) {
  return [...own].map(([name, [low, high]]) => `${name}:${low}:${high}`).join(",");
}

/**
 * Return limits of maps from a text; incomplete entries are ignored.
 * @param {string} text
 * @returns {Map<string, Limits>}
 */
export function limitsFrom(text) {
  const own = new Map();
  for (const entry of text.split(",")) {
    const [name, low, high, ...more] = entry.split(":");
    const [from, to] = [low, high].map((part) => (part ? Number(part) : NaN));
    const good = Math.fround(from) < Math.fround(to) && Number.isFinite(to - from);
    if (name && good && !more.length) own.set(name, [from, to]);
  }
  return own;
}

/** Return the name under which maps keep their limits. Maps with and without the water signal
share them, as do all deviations and significant ones.
 * @param {string} name
 */
export function limitsKey(name) {
  return name === "significant" ? "deviation" : name.replace("_before", "");
}

/** Return the limits in the address of the page; null if there are none. */
export function limitsOfAddress() {
  return new URLSearchParams(location.hash.slice(1)).get("limits");
}

/** Write limits to the address of the page. */
export function addressLimits(own) {
  try {
    const text = limitsText(own);
    history.replaceState(history.state, "", text ? `#limits=${text}` : "#");
  } catch {
    // Pages in frames of reports may have no address.
  }
}

/** Two number fields beside a color bar. */
export class LimitFields {
  #shown = "";
  /** @type {{layer: {kind: string, label: string}, limits: Limits, unit: Unit} | null} */
  #scale = null;
  #change;

  constructor(change) {
    this.#change = change;
    for (const side of /** @type {const} */ (["low", "high"])) {
      const field = $(side);
      field.addEventListener("change", () => this.#typed(side, field));
      field.addEventListener("keydown", (event) => {
        if (event.key !== "Escape") return;
        this.#refill();
        field.select();
      });
    }
  }

  /** Show the limits of a color scale. */
  show(layer, limits, unit) {
    this.#scale = { layer, limits, unit };
    const key = [layer.label, ...limits, unit.unit].join();
    if (key === this.#shown) return;
    this.#shown = key;
    this.#refill();
  }

  #refill() {
    if (!this.#scale) return;
    const { limits, unit } = this.#scale;
    const [low, high] = limits.map((limit) => limit * unit.factor);
    const { step, places } = ticks(low, high, 50);
    for (const [side, value] of Object.entries({ low, high })) {
      const field = $(side);
      // Arrow keys move a limit by a fiftieth of the scale, to round numbers.
      field.step = String(Number(step.toPrecision(1)));
      field.value = value.toFixed(Math.min(places + 1, 12));
      const name = side === "low" ? "Lower" : "Upper";
      field.ariaLabel = `${name} limit of the colors${unit.unit && ` [${unit.unit}]`}`;
      field.ariaInvalid = "false";
    }
    $("limits-note").textContent = "";
  }

  #typed(side, field) {
    if (!this.#scale) return;
    const { layer, limits, unit } = this.#scale;
    const typed = { side, text: field.value, kind: layer.kind, unit };
    try {
      this.#shown = "";
      this.#change(typedLimits(limits, typed));
    } catch (error) {
      field.ariaInvalid = "true";
      $("limits-note").textContent = error.message;
    }
  }
}
