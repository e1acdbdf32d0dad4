// Line profile, histogram and spectrum, drawn on plain canvases.

import { INK } from "./colour.js";
import { inkOf, ratioOf } from "./dom.js";
import { limitsKey } from "./limits.js";
import { fitted } from "./map.js";
import { sampled } from "./scene.js";
import { scaled, ticks } from "./text.js";

/** Return the drawing context and the size of a canvas, cleared. */
export function started(canvas) {
  fitted(canvas);
  const ctx = inkOf(canvas, { plot: true });
  const ratio = ratioOf(canvas);
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, canvas.width, canvas.height);
  return { ctx, width: canvas.width / ratio, height: canvas.height / ratio };
}

/** Draw axes; return the frame, and functions from numbers to places in it. */
export function framed({ ctx, width, height }, x, y, colours, top = 10) {
  const box = { left: 54, top, right: width - 12, bottom: height - 32 };
  const toX = (value) =>
    box.left + ((value - x.low) / (x.high - x.low || 1)) * (box.right - box.left);
  const toY = (value) =>
    box.bottom - ((value - y.low) / (y.high - y.low || 1)) * (box.bottom - box.top);
  ctx.font = `12px ${colours.font}`;
  ctx.strokeStyle = colours.line;
  ctx.fillStyle = colours.soft;
  ctx.lineWidth = 1;
  const down = y.logarithmic
    ? decades(y)
    : ticks(y.low, y.high, Math.max(2, Math.floor((box.bottom - box.top) / 30)));
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  for (const value of down.values) {
    const at = Math.round(toY(value)) + 0.5;
    ctx.beginPath();
    ctx.moveTo(box.left, at);
    ctx.lineTo(box.right, at);
    ctx.stroke();
    const text = y.logarithmic ? power(value) : value.toFixed(down.places);
    ctx.fillText(text.replace("-", "−"), box.left - 6, at);
  }
  const across = ticks(x.low, x.high, Math.max(2, Math.floor((box.right - box.left) / 62)));
  ctx.textAlign = "center";
  ctx.textBaseline = "top";
  for (const value of across.values) {
    const at = toX(value);
    ctx.beginPath();
    ctx.moveTo(at, box.bottom);
    ctx.lineTo(at, box.bottom + 3);
    ctx.stroke();
    ctx.fillText(value.toFixed(across.places).replace("-", "−"), at, box.bottom + 4);
  }
  ctx.textAlign = "right";
  ctx.fillText(x.label, box.right, box.bottom + 18);
  ctx.save();
  ctx.translate(11, box.top);
  ctx.rotate(-Math.PI / 2);
  ctx.fillText(y.label, 0, -6);
  ctx.restore();
  ctx.beginPath();
  ctx.rect(box.left, box.top - 4, box.right - box.left, box.bottom - box.top + 4);
  return { box, toX, toY };
}

function decades({ low, high }) {
  const values = [];
  for (let k = Math.ceil(low); k <= Math.floor(high); k += 1) values.push(k);
  return { values, places: 0 };
}

function power(value) {
  const digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const text = String(Math.abs(value))
    .split("")
    .map((letter) => digits[Number(letter)])
    .join("");
  return `10${value < 0 ? "⁻" : ""}${text}`;
}

/** Draw a text instead of a plot. */
export function empty(view, text, colours) {
  view.ctx.fillStyle = colours.soft;
  view.ctx.font = `13px ${colours.font}`;
  view.ctx.textAlign = "center";
  view.ctx.textBaseline = "middle";
  const words = text.split(" ");
  const lines = [""];
  for (const word of words) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (view.ctx.measureText(longer).width > view.width - 40) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  lines.forEach((line, k) =>
    view.ctx.fillText(line, view.width / 2, view.height / 2 + (k - (lines.length - 1) / 2) * 19),
  );
}

/** Return pixels along a row, a column, or a line between two pixels. */
export function along(scene, { kind, cursor, section }) {
  const { stride } = scene;
  if (kind === "section" && section) {
    const [[r0, c0], [r1, c1]] = section;
    const count = Math.max(Math.abs(r1 - r0), Math.abs(c1 - c0)) / stride + 1;
    return Array.from({ length: Math.ceil(count) }, (_, k) => {
      const share = count > 1 ? k / (count - 1) : 0;
      return [Math.round(r0 + share * (r1 - r0)), Math.round(c0 + share * (c1 - c0))];
    });
  }
  if (!cursor) return [];
  if (kind === "column")
    return Array.from({ length: scene.high }, (_, k) => [k * stride, cursor[1]]);
  return Array.from({ length: scene.wide }, (_, k) => [cursor[0], k * stride]);
}

/** Return a profile: distance along it [m], and values of a map with uncertainties. */
export function profileOf(scene, pixels, name) {
  const places = pixels.map(([row, column]) => scene.beams.point(row, column, scene.typical));
  const errors = limitsKey(name) === "deviation" ? "deviation_uncertainty" : "uncertainty";
  let run = 0;
  return pixels.map((pixel, k) => {
    if (k) run += Math.hypot(...[0, 1, 2].map((axis) => places[k][axis] - places[k - 1][axis]));
    return {
      pixel,
      x: run,
      value: scene.value(name, ...pixel),
      error: name.endsWith("_before") ? NaN : scene.value(errors, ...pixel),
    };
  });
}

/** Draw the profile through the cursor or along the section. */
export function drawProfile(canvas, state, colours) {
  const view = started(canvas);
  const { scene, cursor, section, profileKind: kind, profileLayer: name } = state;
  const layer = scene.byName.get(name);
  const pixels = along(scene, { kind, cursor, section });
  if (pixels.length < 2) {
    return empty(view, "Point at the map to see the profile through a pixel.", colours);
  }
  const line = profileOf(scene, pixels, name);
  const twin = layer.before ? name.replace("_before", "") : `${name}_before`;
  const other =
    scene.maps.has(twin) && layer.kind !== "flags" ? profileOf(scene, pixels, twin) : null;
  const known = line.filter((one) => Number.isFinite(one.value));
  if (!known.length) return empty(view, "No pixel of this line holds a number.", colours);
  const uncertain = (layer.kind === "range" && !layer.before) || limitsKey(name) === "deviation";
  const [low, high] = profileLimits(line, other, uncertain, scene.least(name));
  const room = (high - low) * 0.08;
  const unit = profileUnit(layer, low, high);
  const span = line.at(-1).x;
  const across = span < 2 ? { factor: 1e3, unit: "mm" } : { factor: 1, unit: "m" };
  const frame = framed(
    view,
    { low: 0, high: span * across.factor, label: `along the line [${across.unit}]` },
    {
      low: (low - room) * unit.factor,
      high: (high + room) * unit.factor,
      label: `${layer.label} [${unit.unit || "1"}]`,
    },
    colours,
    24,
  );
  const { ctx } = view;
  const spot = (x, value) => [frame.toX(x * across.factor), frame.toY(value * unit.factor)];
  ctx.save();
  ctx.clip();
  if (uncertain) band(ctx, line, spot, colours.band);
  if (other) stroke(ctx, other, spot, INK.vermilion, 1, [4, 3]);
  stroke(ctx, line, spot, colours.accent, 1.6);
  const here = cursor && line.find(({ pixel }) => pixel[0] === cursor[0] && pixel[1] === cursor[1]);
  if (here) upright(ctx, spot(here.x, 0)[0], frame.box, colours.soft);
  ctx.restore();
  const names = layer.before ? ["water in", "water removed"] : ["water removed", "water in"];
  const entries = [[other || layer.before ? names[0] : layer.label, colours.accent, []]];
  if (other) entries.push([names[1], INK.vermilion, [4, 3]]);
  if (uncertain && known.some((one) => Number.isFinite(one.error))) {
    entries.push(["± standard uncertainty", colours.band, null]);
  }
  return legend(ctx, frame.box, entries, colours);
}

/** Return the limits between which a profile is drawn. */
function profileLimits(line, other, uncertain, least) {
  const known = line.filter((one) => Number.isFinite(one.value));
  const sizes = known.map((one) => one.value).sort((a, b) => a - b);
  const spreads = uncertain ? known.map((one) => one.error || 0).sort((a, b) => a - b) : [0];
  const spread = 2 * spreads[spreads.length >> 1];
  let low = sizes[Math.floor(0.005 * sizes.length)] - spread;
  let high = sizes[Math.ceil(0.995 * (sizes.length - 1))] + spread;
  // Without a target, raw ranges are those of the water alone.
  const beside = (other ?? [])
    .filter((one, k) => Number.isFinite(line[k].value) && Number.isFinite(one.value))
    .map((one) => one.value)
    .sort((a, b) => a - b);
  if (beside.length) {
    low = Math.min(low, beside[Math.floor(0.03 * beside.length)]);
    high = Math.max(high, beside[Math.floor(0.97 * (beside.length - 1))]);
  }
  const missing = Math.max(least - (high - low) / 2, 0);
  return [low - missing, high + missing];
}

function profileUnit({ kind, unit }, low, high) {
  if (high - low < 0.02 && kind !== "range") {
    return scaled(Math.max(Math.abs(low), Math.abs(high)), unit);
  }
  return unit === "V" ? scaled(high, "V") : { unit, factor: 1 };
}

/** Draw the values of a profile, with gaps at missing values. */
function stroke(ctx, line, spot, colour, width, dash = []) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.setLineDash(dash);
  ctx.beginPath();
  let pen = false;
  for (const { x, value } of line) {
    const known = Number.isFinite(value);
    if (known) ctx[pen ? "lineTo" : "moveTo"](...spot(x, value));
    pen = known;
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Fill the band of one standard uncertainty around a profile. */
function band(ctx, line, spot, colour) {
  ctx.fillStyle = colour;
  let part = [];
  const close = () => {
    if (part.length > 1) {
      ctx.beginPath();
      for (const one of part) ctx.lineTo(...spot(one.x, one.value + one.error));
      for (const one of part.reverse()) ctx.lineTo(...spot(one.x, one.value - one.error));
      ctx.fill();
    }
    part = [];
  };
  for (const one of line) {
    if (Number.isFinite(one.value) && Number.isFinite(one.error)) part.push(one);
    else close();
  }
  close();
}

/** Draw a vertical line through a frame. */
function upright(ctx, x, { top, bottom }, colour) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  ctx.beginPath();
  ctx.moveTo(x, top - 4);
  ctx.lineTo(x, bottom);
  ctx.stroke();
}

function legend(ctx, box, entries, colours) {
  ctx.font = `12px ${colours.font}`;
  ctx.textBaseline = "middle";
  ctx.textAlign = "left";
  // The legend is above the frame, where it hides no line, and denser if narrow.
  const words = entries.reduce((sum, [text]) => sum + ctx.measureText(text).width, 0);
  const room = box.right - 20;
  const long = Math.min(18, Math.max(9, (room - words) / entries.length - 18));
  const step = long + 4 + Math.min(16, Math.max(5, (room - words) / entries.length - long - 4));
  let x = Math.max(box.right - words - entries.length * step + (step - long - 4), 20);
  const y = box.top - 14;
  for (const [text, colour, dash] of entries) {
    ctx.strokeStyle = colour;
    ctx.fillStyle = colour;
    if (dash === null) ctx.fillRect(x, y - 5, long, 10);
    else {
      ctx.lineWidth = 1.8;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x, y);
      ctx.lineTo(x + long, y);
      ctx.stroke();
      ctx.setLineDash([]);
    }
    ctx.fillStyle = colours.soft;
    ctx.fillText(text, x + long + 4, y);
    x += ctx.measureText(text).width + step;
  }
}

/** Size of the drawing of a half-profile in the list of measurements [page pixel]. */
const HALF = { width: 258, height: 190, left: 44, top: 10, bottom: 20 };

/** Return a drawing of a half-profile with its mirror image, at one scale in both directions. */
export function halfProfile({ height, radius, uncertainty }, colours) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width: HALF.width * ratio, height: HALF.height * ratio });
  canvas.className = "half";
  const ctx = inkOf(canvas);
  ctx.scale(ratio, ratio);
  const [tall, wide] = [Math.max(...height), Math.max(...radius)];
  const low = HALF.height - HALF.bottom;
  const room = HALF.width - HALF.left - 10;
  const scale = Math.min((low - HALF.top) / tall, room / (2 * wide));
  const middle = HALF.left + room / 2;
  const spot = (side, k, more = 0) => [
    middle + side * (radius[k] + more) * scale,
    low - height[k] * scale,
  ];
  const all = height.map((_, k) => k);
  const path = (spots) => spots.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.fillStyle = colours.band;
  ctx.beginPath();
  path([
    ...all.map((k) => spot(-1, k, uncertainty[k] ?? 0)),
    ...[...all].reverse().map((k) => spot(-1, k, -(uncertainty[k] ?? 0))),
  ]);
  ctx.fill();
  ctx.strokeStyle = colours.accent;
  ctx.lineWidth = 1.6;
  ctx.beginPath();
  path(all.map((k) => spot(-1, k)));
  path(all.map((k) => spot(1, k)));
  ctx.stroke();
  ctx.strokeStyle = ctx.fillStyle = colours.soft;
  ctx.lineWidth = 1;
  ctx.setLineDash([7, 3, 1.5, 3]);
  ctx.beginPath();
  path([
    [middle, HALF.top - 4],
    [middle, low + 4],
  ]);
  ctx.stroke();
  ctx.setLineDash([]);
  heights(ctx, tall, (value) => low - value * scale, colours);
  return canvas;
}

/** Draw a scale of heights in millimeters. */
function heights(ctx, tall, toY, colours) {
  ctx.font = `12px ${colours.font}`;
  ctx.textAlign = "right";
  ctx.textBaseline = "middle";
  ctx.beginPath();
  for (const value of ticks(0, tall * 1e3, 4).values) {
    const y = toY(value / 1e3);
    ctx.moveTo(HALF.left - 4, y);
    ctx.lineTo(HALF.left, y);
    ctx.fillText(String(Math.round(value)), HALF.left - 6, y);
  }
  ctx.stroke();
  ctx.textAlign = "left";
  ctx.fillText("height [mm]", 2, HALF.height - 7);
}

/** Draw the histogram of the shown map, with bars in the colors of the map. */
export function drawHistogram(canvas, state, colours) {
  const view = started(canvas);
  const map = state.scene.maps.get(state.layerName);
  if (!map) return;
  const { layer } = map;
  if (layer.kind === "flags") return drawFlags(view, state, colours);
  const [low, high] = state.limits;
  const bins = 64;
  const counts = new Array(bins).fill(0);
  let under = 0;
  let over = 0;
  const some = sampled(map.values, 400000);
  let finite = 0;
  for (const value of some) {
    if (!Number.isFinite(value)) continue;
    finite += 1;
    const at = Math.floor(((value - low) / (high - low)) * bins);
    if (at < 0) under += 1;
    else if (at >= bins) over += 1;
    else counts[at] += 1;
  }
  if (!finite) return empty(view, "No pixel holds a number.", colours);
  const unit =
    layer.kind === "range"
      ? { unit: layer.unit, factor: 1 }
      : scaled(Math.max(Math.abs(low), Math.abs(high)), layer.unit);
  const most = Math.max(...counts);
  const frame = framed(
    view,
    {
      low: low * unit.factor,
      high: high * unit.factor,
      label: `${layer.label} [${unit.unit || "1"}]`,
    },
    { low: 0, high: (most / finite) * 100 * 1.08, label: `${state.counted ?? "pixels"} [%]` },
    colours,
  );
  const table = state.tables[layer.kind];
  for (let k = 0; k < bins; k += 1) {
    const left = frame.toX((low + ((high - low) * k) / bins) * unit.factor);
    const right = frame.toX((low + ((high - low) * (k + 1)) / bins) * unit.factor);
    const top = frame.toY((counts[k] / finite) * 100);
    const at = 4 * Math.floor(((k + 0.5) / bins) * 255);
    view.ctx.fillStyle = `rgb(${table[at]},${table[at + 1]},${table[at + 2]})`;
    view.ctx.fillRect(left, top, Math.max(right - left - 0.6, 0.6), frame.box.bottom - top);
    view.ctx.strokeStyle = colours.line;
    // Outlines of narrow bars would hide their colors.
    if (counts[k] && right - left > 5)
      view.ctx.strokeRect(left, top, Math.max(right - left - 0.6, 0.6), frame.box.bottom - top);
  }
  const beside = [under && `${under} below`, over && `${over} above`].filter(Boolean).join(", ");
  if (beside) {
    view.ctx.fillStyle = colours.soft;
    view.ctx.textAlign = "right";
    view.ctx.textBaseline = "top";
    view.ctx.fillText(beside, frame.box.right, 0);
  }
}

function drawFlags({ ctx, width, height }, state, colours) {
  const { values } = state.scene.maps.get(state.layerName);
  const counts = state.scene.flags
    .map((flag) => [flag, values.reduce((sum, bits) => sum + (bits & flag.mask ? 1 : 0), 0)])
    .filter(([, count]) => count);
  const good = values.reduce((sum, bits) => sum + (bits === 0 ? 1 : 0), 0);
  const rows = [
    [{ name: "good" }, good, "#2c7f62"],
    ...counts.map(([flag, count]) => [flag, count, state.flagColour(flag.name)]),
  ];
  const step = Math.min(24, (height - 16) / rows.length);
  ctx.font = `12px ${colours.font}`;
  ctx.textBaseline = "middle";
  rows.forEach(([flag, count, colour], k) => {
    const y = 10 + k * step + step / 2;
    ctx.fillStyle = colours.soft;
    ctx.textAlign = "right";
    ctx.fillText(flag.name, 112, y);
    const long = ((width - 190) * count) / values.length;
    ctx.fillStyle = colour;
    ctx.fillRect(120, y - step * 0.32, Math.max(long, 2), step * 0.64);
    ctx.fillStyle = colours.ink;
    ctx.textAlign = "left";
    const share = (count / values.length) * 100;
    ctx.fillText(`${share < 0.1 ? "< 0.1" : share.toFixed(1)} %`, 126 + Math.max(long, 2), y);
  });
}

/** Draw the spectrum of a pixel, or its phasors for a single frequency. */
export function drawSpectrum(canvas, state, colours) {
  const view = started(canvas);
  const { spectrum, scene } = state;
  if (!scene.spectrum)
    return empty(
      view,
      "A range image holds no samples; name them by --samples to see spectra.",
      colours,
    );
  if (!spectrum) return empty(view, "Point at a pixel to see its spectrum.", colours);
  const parts = [
    ["after", "target", colours.accent, []],
    ["before", "raw", INK.vermilion, [4, 3]],
    ["water", "water", INK.sky, [1, 3]],
  ].filter(([name]) => spectrum[name]);
  // The range of a new row comes before its signals.
  const { cursor } = state;
  const known = cursor && Number.isFinite(scene.value(scene.main, ...cursor));
  const missing = known ? "being estimated" : "not measured";
  if (spectrum.frequency.length === 1) return drawPhasors(view, spectrum, parts, missing, colours);
  const all = parts.flatMap(([name]) => spectrum[name].amplitude).filter((value) => value > 0);
  if (!all.length) return empty(view, `This pixel is ${missing}.`, colours);
  const frequency = spectrum.frequency.map((value) => value / 1e6);
  const [low, high] = [Math.log10(Math.min(...all)) - 0.15, Math.log10(Math.max(...all)) + 0.2];
  const margin = (frequency.at(-1) - frequency[0]) * 0.03;
  const wide = high - low < 1.2;
  const unit = scaled(10 ** high, "V");
  const toValue = wide ? (value) => value * unit.factor : (value) => Math.log10(value);
  const y = wide
    ? { low: 0, high: 10 ** high * unit.factor, label: `amplitude [${unit.unit}]` }
    : { low, high, label: "amplitude [V]", logarithmic: true };
  const frame = framed(
    view,
    {
      low: frequency[0] - margin,
      high: frequency.at(-1) + margin,
      label: "modulation frequency [MHz]",
    },
    y,
    colours,
    24,
  );
  const { ctx } = view;
  for (const [name, , colour, dash] of parts) {
    const spots = frequency.map((at) => frame.toX(at));
    const toY = (value) => frame.toY(toValue(value));
    ctx.strokeStyle = ctx.fillStyle = colour;
    drawLine(ctx, spectrum[name], spots, toY, dash);
  }
  legend(
    ctx,
    frame.box,
    parts.map(([, text, colour, dash]) => [text, colour, dash]),
    colours,
  );
}

/** Draw amplitudes over frequencies: a line, dots, and their uncertainties. */
function drawLine(ctx, { amplitude, uncertainty }, spots, toY, dash) {
  ctx.lineWidth = 1.5;
  ctx.setLineDash(dash);
  ctx.beginPath();
  amplitude.forEach((value, k) => value > 0 && ctx.lineTo(spots[k], toY(value)));
  ctx.stroke();
  ctx.setLineDash([]);
  amplitude.forEach((value, k) => {
    if (!(value > 0)) return;
    ctx.beginPath();
    ctx.arc(spots[k], toY(value), 2.6, 0, 7);
    ctx.fill();
    const error = uncertainty?.[k];
    if (!error) return;
    ctx.beginPath();
    ctx.moveTo(spots[k], toY(value + error));
    ctx.lineTo(spots[k], toY(Math.max(value - error, value * 1e-3)));
    ctx.stroke();
  });
}

function drawPhasors({ ctx, width, height }, spectrum, parts, missing, colours) {
  const largest = Math.max(...parts.map(([name]) => spectrum[name].amplitude[0] || 0));
  if (!(largest > 0)) return empty({ ctx, width, height }, `This pixel is ${missing}.`, colours);
  const size = Math.min(width - 122, height - 12) / 2;
  const [x0, y0] = [4 + size, height / 2];
  const scale = (size * 0.92) / largest;
  const spot = (name) => {
    const [amplitude, phase] = [spectrum[name].amplitude[0], spectrum[name].phase[0]];
    return [x0 + scale * amplitude * Math.cos(phase), y0 - scale * amplitude * Math.sin(phase)];
  };
  rings(ctx, x0, y0, size, colours.line);
  ctx.font = `12px ${colours.font}`;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  const left = x0 + size + 10;
  parts.forEach(([name, text, colour, dash], k) => {
    const { amplitude, phase, uncertainty } = spectrum[name];
    const measured = amplitude[0] !== null;
    if (measured) {
      // Water and target add up to the raw signal.
      const added = name === "after" && spectrum.water && spectrum.before?.amplitude[0];
      const to = spot(added ? "before" : name);
      arrow(ctx, added ? spot("water") : [x0, y0], to, colour, dash);
      if (uncertainty) disc(ctx, to, Math.max(scale * uncertainty[0], 1), colour);
    }
    const y = 22 + k * 40;
    ctx.strokeStyle = colour;
    ctx.setLineDash(dash);
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(left, y);
    ctx.lineTo(left + 18, y);
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.fillStyle = colours.ink;
    ctx.fillText(text, left + 24, y);
    ctx.fillStyle = colours.soft;
    const { unit, factor } = scaled(largest, "V");
    const turn = ((phase[0] * 180) / Math.PI).toFixed(1).replace("-", "−");
    const value = `${(amplitude[0] * factor).toPrecision(3)} ${unit}, ${turn}°`;
    ctx.fillText(measured ? value : missing, left, y + 17);
  });
  ctx.fillStyle = colours.soft;
  return ctx.fillText(`${(spectrum.frequency[0] / 1e6).toFixed(2)} MHz`, left, height - 14);
}

/** Draw the axes of phasors, with circles at half and full of the largest amplitude. */
function rings(ctx, x, y, size, colour) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  for (const share of [0.5, 1]) {
    ctx.beginPath();
    ctx.arc(x, y, size * 0.92 * share, 0, 7);
    ctx.stroke();
  }
  ctx.beginPath();
  ctx.moveTo(x - size, y);
  ctx.lineTo(x + size, y);
  ctx.moveTo(x, y - size);
  ctx.lineTo(x, y + size);
  ctx.stroke();
}

/**
 * Fill a circle faintly.
 * @param {CanvasRenderingContext2D} ctx
 * @param {number[]} middle
 * @param {number} radius
 * @param {string} colour
 */
function disc(ctx, [x, y], radius, colour) {
  ctx.globalAlpha = 0.25;
  ctx.fillStyle = colour;
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 7);
  ctx.fill();
  ctx.globalAlpha = 1;
}

function arrow(ctx, from, to, colour, dash) {
  ctx.strokeStyle = colour;
  ctx.fillStyle = colour;
  ctx.lineWidth = 2;
  ctx.setLineDash(dash);
  ctx.beginPath();
  ctx.moveTo(...from);
  ctx.lineTo(...to);
  ctx.stroke();
  ctx.setLineDash([]);
  const turn = Math.atan2(to[1] - from[1], to[0] - from[0]);
  ctx.beginPath();
  ctx.moveTo(...to);
  for (const side of [-0.4, 0.4])
    ctx.lineTo(to[0] - 9 * Math.cos(turn + side), to[1] - 9 * Math.sin(turn + side));
  ctx.fill();
}
