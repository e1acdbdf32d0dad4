// Numbers as text, with suitable units and as many digits as the uncertainty permits.

const LENGTHS = [
  { unit: "m", factor: 1 },
  { unit: "mm", factor: 1e3 },
  { unit: "µm", factor: 1e6 },
];
const AREAS = [
  { unit: "m²", factor: 1 },
  { unit: "cm²", factor: 1e4 },
  { unit: "mm²", factor: 1e6 },
];
const VOLUMES = [
  { unit: "m³", factor: 1 },
  { unit: "dm³", factor: 1e3 },
  { unit: "cm³", factor: 1e6 },
  { unit: "mm³", factor: 1e9 },
];
const VOLTS = [
  { unit: "V", factor: 1 },
  { unit: "mV", factor: 1e3 },
  { unit: "µV", factor: 1e6 },
  { unit: "nV", factor: 1e9 },
];

/**
 * Return a suitable unit for a value, and its factor.
 * @param {number} size
 * @param {string} unit
 * @returns {{unit: string, factor: number}}
 */
export function scaled(size, unit) {
  const magnitude = Math.abs(size);
  if (unit === "m")
    return magnitude >= 1
      ? LENGTHS[0]
      : magnitude >= 1e-3 || magnitude === 0
        ? LENGTHS[1]
        : LENGTHS[2];
  if (unit === "m2") return magnitude >= 1 ? AREAS[0] : magnitude >= 1e-3 ? AREAS[1] : AREAS[2];
  if (unit === "m3") return VOLUMES.find((one) => magnitude * one.factor >= 1) ?? VOLUMES[3];
  if (unit === "V") return VOLTS.find((one) => magnitude * one.factor >= 1) ?? VOLTS[3];
  if (unit === "rad") return { unit: "°", factor: 180 / Math.PI };
  return { unit: "", factor: 1 };
}

/**
 * Return a number with a few digits, without an exponent if possible.
 * @param {number | null} value
 * @param {number} [digits]
 */
export function short(value, digits = 4) {
  if (value === null || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.floor(Math.log10(Math.abs(value)));
  if (size < -4 || size > 6) return value.toExponential(Math.max(digits - 1, 0));
  return minus(value.toFixed(Math.max(0, digits - 1 - size)));
}

/**
 * Return a value with its unit.
 * @param {number | null} value
 * @param {string} unit
 * @param {number} [digits]
 */
export function withUnit(value, unit, digits = 4) {
  if (value === null || !Number.isFinite(value)) return "–";
  const one = scaled(value, unit);
  return `${short(value * one.factor, digits)}${one.unit === "°" ? "" : " "}${one.unit}`.trim();
}

/**
 * Return a value with its standard uncertainty in two digits.
 * @param {number} value
 * @param {number} uncertainty
 * @param {string} unit
 */
export function withError(value, uncertainty, unit) {
  if (!Number.isFinite(uncertainty) || uncertainty <= 0) return withUnit(value, unit);
  // Lengths up to ten meters are shown in millimeters if their error is of that size.
  const one =
    unit === "m" && Math.abs(value) < 10 && uncertainty < 0.1
      ? LENGTHS[1]
      : scaled(Math.max(Math.abs(value), uncertainty), unit);
  const error = uncertainty * one.factor;
  const places = Math.max(0, 1 - Math.floor(Math.log10(error)));
  const number = minus((value * one.factor).toFixed(places));
  const gap = one.unit === "" ? "" : one.unit === "°" ? "" : " ";
  const both = `${number} ± ${error.toFixed(places)}`;
  return gap || one.unit === "" ? `${both}${gap}${one.unit}` : `(${both})${one.unit}`;
}

/**
 * @param {string} text
 */
function minus(text) {
  return text.replace("-", "−");
}

/**
 * Return ticks at round numbers, and their number of decimal places.
 * @param {number} low
 * @param {number} high
 * @param {number} [wanted]
 */
export function ticks(low, high, wanted = 5) {
  const span = high - low;
  if (!(span > 0)) return { values: [low], places: 2, step: 0 };
  const raw = span / wanted;
  const size = 10 ** Math.floor(Math.log10(raw));
  const step = size * ([1, 2, 5].find((one) => one * size >= raw) ?? 10);
  const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const values = [];
  for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + 1e-9 * span; at += step)
    // A sum of steps misses zero by rounding, which would be shown as -0.
    values.push(Math.abs(at) < 1e-9 * span ? 0 : at);
  return { values, places, step };
}

/**
 * Return the time of day some seconds from now, with the weekday if not today.
 * @param {number} seconds
 * @param {Date} now
 */
export function clockIn(seconds, now) {
  const end = new Date(now.getTime() + 1000 * seconds);
  const clock = `${String(end.getHours()).padStart(2, "0")}:${String(end.getMinutes()).padStart(2, "0")}`;
  if (end.toDateString() === now.toDateString()) return clock;
  return `${end.toLocaleDateString("en", { weekday: "short" })} ${clock}`;
}

/**
 * Return a duration in seconds as readable text.
 * @param {number} seconds
 */
export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  const whole = Math.max(0, Math.round(seconds));
  const hours = Math.floor(whole / 3600);
  const minutes = Math.floor((whole % 3600) / 60);
  if (hours) return `${hours} h ${String(minutes).padStart(2, "0")} min`;
  if (minutes) return `${minutes} min ${String(whole % 60).padStart(2, "0")} s`;
  return `${whole} s`;
}
