// Figures of docs/learn: sliders, and curves computed from tables of amulor's own models.
"use strict";
(() => {
const LIGHT = 299792458;
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];
const table = () => window.amulorTables;

// ------------------------------------------------------------------ the model
/** Value between the nodes of a table that rises, and its ends beyond them. */
function between(nodes, values, x) {
  let i = 0;
  while (i < nodes.length - 2 && nodes[i + 1] < x) i += 1;
  const t = Math.min(Math.max((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0), 1);
  return values[i] * (1 - t) + values[i + 1] * t;
}
/** Radians that the phase gains with each metre of distance. */
const phasePerMetre = (mhz) => 4 * Math.PI * mhz * 1e6 * table().groupIndex / LIGHT;
/** Phasor of open water over launched power. */
const water = (state, mhz) => [
  between(table().frequency, table().inPhase[state.water], mhz),
  between(table().frequency, table().quadrature[state.water], mhz),
];
/** Size of the echo over launched power. The logarithm of echo * d^2 is near a line. */
function echo(state) {
  const {distance, echo: echoes} = table();
  const flat = echoes[state.water].map((e, i) => Math.log(e * distance[i] ** 2));
  const size = Math.exp(between(distance, flat, state.distance)) / state.distance ** 2;
  return size * (state.reflectance ?? 0.1);
}
/** Phasor of the target. */
function target(state, mhz) {
  const size = echo(state), phase = phasePerMetre(mhz) * state.distance;
  return [size * Math.cos(phase), size * Math.sin(phase)];
}
/** Error of the distance [mm] that a phasor beside the target makes. */
function rangeError(t, extra, mhz) {
  const re = t[0] + extra[0], im = t[1] + extra[1];
  const turn = Math.atan2(im * t[0] - re * t[1], re * t[0] + im * t[1]);
  return 1e3 * turn / phasePerMetre(mhz);
}
const scaled = (v, s) => [v[0] * s, v[1] * s];
/** Standard deviation of the distance [mm] by counting photoelectrons. */
function spread(state, mhz, kept = 1) {
  const time = state.dwell * 1e-3 * table().photoelectrons;
  const light = echo(state) * kept * time;
  const all = light + Math.hypot(...water(state, 0)) * kept * time;
  return 1e3 * Math.SQRT2 * Math.sqrt(all) / (0.8 * light) / phasePerMetre(mhz);
}
const sweep = (f, from = 4) => table().frequency.filter((m) => m >= from)
  .map((m) => [m, f(m)]);

// ------------------------------------------------------------------- drawing
/** The next of 2, 4 and 10 times a power of ten. */
function nice(value) {
  const unit = 10 ** Math.floor(Math.log10(value));
  return unit * [1, 2, 4, 10].find((step) => step * unit >= value * (1 - 1e-9));
}
function ink(canvas) {
  const style = getComputedStyle(document.documentElement);
  const find = (name, other) => style.getPropertyValue(name).trim() || other;
  return {text: find("--pst-color-text-base", "#222"), faint: find("--pst-color-border", "#ccc")};
}
/** Draw curves with axes; a curve is {points, label, dash}. */
function plot(context, box, {curves, marks = [], x, y, low, high, log = false}) {
  const {left, top, width, height} = box, {text, faint} = ink();
  const rise = (v) => log ? Math.log10(Math.max(v, 1e-12)) : v;
  const all = curves.flatMap((c) => c.points.map((p) => p[1])).filter(Number.isFinite);
  let bottom = rise(low ?? Math.min(0, ...all)), up = rise(high ?? Math.max(...all) * 1.05);
  if (!(up > bottom)) up = bottom + 1;
  const ends = curves[0].points, last = ends[ends.length - 1][0];
  const first = ends[0][0] <= 10 ? 0 : ends[0][0];
  const px = (v) => left + (v - first) / (last - first) * width;
  const py = (v) => top + height - (rise(v) - bottom) / (up - bottom) * height;
  context.strokeStyle = faint; context.fillStyle = text; context.lineWidth = 1;
  context.strokeRect(left, top, width, height);
  context.font = "12px sans-serif"; context.textAlign = "center";
  for (let i = 0; i <= 4; i += 1) {
    const value = first + (last - first) * i / 4;
    context.fillText(Number(value.toPrecision(3)), px(value), top + height + 15);
  }
  context.fillText(x, left + width / 2, top + height + 32);
  context.textAlign = "right";
  const decades = log ? Math.round(up - bottom) : 4;
  for (let i = 0; i <= decades; i += 1) {
    const level = bottom + (up - bottom) * i / decades, value = log ? 10 ** level : level;
    const at = top + height - height * i / decades;
    context.fillText(Number(value.toPrecision(2)), left - 5, at + 4);
    context.beginPath(); context.moveTo(left, at); context.lineTo(left + width, at); context.stroke();
  }
  context.save(); context.translate(left - 46, top + height / 2); context.rotate(-Math.PI / 2);
  context.textAlign = "center"; context.fillText(y, 0, 0); context.restore();
  context.save(); context.beginPath(); context.rect(left, top, width, height); context.clip();
  curves.forEach((curve, i) => {
    context.strokeStyle = curve.colour ?? COLOURS[i % COLOURS.length];
    context.lineWidth = curve.wide ?? 2; context.setLineDash(curve.dash ?? []);
    context.beginPath();
    curve.points.forEach(([u, v], j) => context[j ? "lineTo" : "moveTo"](px(u), py(v)));
    context.stroke(); context.setLineDash([]);
  });
  marks.forEach((mark) => {
    context.strokeStyle = text; context.lineWidth = 1; context.setLineDash([3, 3]);
    context.beginPath(); context.moveTo(px(mark), top); context.lineTo(px(mark), top + height);
    context.stroke(); context.setLineDash([]);
  });
  context.restore();
  context.textAlign = "left";
  let row = top + 16;
  curves.forEach((curve, i) => {
    if (!curve.label) return;
    context.fillStyle = curve.colour ?? COLOURS[i % COLOURS.length];
    context.fillRect(left + width - 150, row - 6, 14, 3);
    context.fillStyle = text; context.fillText(curve.label, left + width - 130, row);
    row += 16;
  });
}
/** Draw phasors as arrows; one is {at, tip, label}. */
function phasors(context, box, arrows) {
  const {left, top, width, height} = box, {text, faint} = ink();
  const reach = Math.max(...arrows.flatMap((a) => [Math.hypot(...a.tip), Math.hypot(...a.at)]), 1e-30);
  const scale = 0.46 * Math.min(width, height) / reach;
  const place = ([u, v]) => [left + width / 2 + u * scale, top + height / 2 - v * scale];
  context.strokeStyle = faint; context.lineWidth = 1; context.strokeRect(left, top, width, height);
  context.beginPath();
  context.moveTo(left, top + height / 2); context.lineTo(left + width, top + height / 2);
  context.moveTo(left + width / 2, top); context.lineTo(left + width / 2, top + height);
  context.stroke();
  context.fillStyle = text; context.font = "12px sans-serif"; context.textAlign = "center";
  context.fillText("in phase", left + width / 2, top + height + 15);
  arrows.forEach((arrow, i) => {
    const [x0, y0] = place(arrow.at), [x1, y1] = place(arrow.tip);
    const turn = Math.atan2(y1 - y0, x1 - x0);
    context.strokeStyle = context.fillStyle = arrow.colour ?? COLOURS[i % COLOURS.length];
    context.lineWidth = 2.5; context.beginPath(); context.moveTo(x0, y0); context.lineTo(x1, y1); context.stroke();
    context.beginPath(); context.moveTo(x1, y1);
    context.lineTo(x1 - 9 * Math.cos(turn - 0.4), y1 - 9 * Math.sin(turn - 0.4));
    context.lineTo(x1 - 9 * Math.cos(turn + 0.4), y1 - 9 * Math.sin(turn + 0.4));
    context.closePath(); context.fill();
    context.textAlign = "left"; context.fillText(arrow.label, left + 8, top + 18 + 16 * i);
  });
}
/** Divide the canvas: arrows left and a curve right, or one above the other. */
function boxes(canvas, narrow) {
  const w = canvas.clientWidth, h = canvas.clientHeight;
  if (narrow) {
    return [{left: 60, top: 10, width: w - 75, height: h / 2 - 40},
            {left: 60, top: h / 2 + 10, width: w - 75, height: h / 2 - 55}];
  }
  return [{left: 10, top: 10, width: w * 0.36, height: h - 45},
          {left: w * 0.36 + 80, top: 10, width: w * 0.64 - 95, height: h - 55}];
}

// ------------------------------------------------------------------- figures
const SLIDERS = {
  frequency: ["Modulation frequency", 4, 200, 1, 40, (v) => `${v} MHz`],
  distance: ["Distance", 0.5, 6, 0.05, 2, (v) => `${v.toFixed(2)} m`],
  water: ["Attenuation", 0, 5, 1, 3, (v) => `${table().attenuation[v]} 1/m`],
  reflectance: ["Reflectance", 0.02, 1, 0.02, 0.1, (v) => `${Math.round(100 * v)} %`],
  drift: ["Water changed by", -20, 20, 1, 5, (v) => `${v} %`],
  targetKeeps: ["Polarization kept by target", 0, 1, 0.01, 0.61, (v) => `${Math.round(100 * v)} %`],
  waterKeeps: ["Polarization kept by water", 0.5, 1, 0.01, 0.96, (v) => `${Math.round(100 * v)} %`],
  dwell: ["Measuring time", 1, 200, 1, 10, (v) => `${v} ms`],
};
const FIGURES = {
  "lock-in": {
    sliders: ["frequency", "distance"],
    draw(context, [one, two], state) {
      const k = phasePerMetre(state.frequency), phase = k * state.distance;
      phasors(context, one, [{at: [0, 0], tip: [Math.cos(phase), Math.sin(phase)], label: "echo"}]);
      const wrapped = (d) => (k * d) % (2 * Math.PI) * 180 / Math.PI;
      const places = Array.from({length: 400}, (_, i) => 0.5 + 5.5 * i / 399);
      plot(context, two, {curves: [{points: places.map((d) => [d, wrapped(d)])}],
        marks: [state.distance], x: "distance [m]", y: "phase [deg]", low: 0, high: 360});
      return `Phase: ${(wrapped(state.distance)).toFixed(1)} deg. One degree is a distance of `
        + `${(1e3 * Math.PI / 180 / k).toFixed(2)} mm. The phase repeats every ${(2 * Math.PI / k).toFixed(3)} m.`;
    },
  },
  "two-phasors": {
    sliders: ["water", "distance", "reflectance", "frequency"],
    draw(context, [one, two], state) {
      const t = target(state, state.frequency), w = water(state, state.frequency);
      phasors(context, one, [
        {at: [0, 0], tip: t, label: "target"}, {at: t, tip: [t[0] + w[0], t[1] + w[1]], label: "water"},
        {at: [0, 0], tip: [t[0] + w[0], t[1] + w[1]], label: "measured"}]);
      const points = sweep((m) => rangeError(target(state, m), water(state, m), m), 10);
      const top = nice(Math.max(5, ...points.map((p) => Math.abs(p[1]))));
      plot(context, two, {curves: [{points}], marks: [state.frequency], low: -top, high: top,
        x: "modulation frequency [MHz]", y: "range error [mm]"});
      return `Ratio of water to target: ${(Math.hypot(...w) / Math.hypot(...t)).toPrecision(3)}. Range error: `
        + `${rangeError(t, w, state.frequency).toFixed(2)} mm.`;
    },
  },
  "low-pass": {
    sliders: ["water"],
    single: true,
    draw(context, [, two], state) {
      const curves = table().attenuation.map((c, i) => ({
        points: sweep((m) => Math.hypot(...water({water: i}, m)) / Math.hypot(...water({water: i}, 0)), 0),
        label: `${c} 1/m`, wide: i === state.water ? 4 : 1.2, colour: COLOURS[i]}));
      plot(context, two, {curves, marks: [table().cutOff[state.water]], low: 0, high: 1,
        x: "modulation frequency [MHz]", y: "water signal / value at 0 MHz"});
      return `At ${table().attenuation[state.water]} 1/m the water signal falls to 1/sqrt(2) at `
        + `${table().cutOff[state.water].toFixed(1)} MHz.`;
    },
  },
  "open-water": {
    sliders: ["water", "distance", "reflectance", "drift"],
    single: true,
    draw(context, [, two], state) {
      const off = (part) => sweep((m) => Math.abs(rangeError(target(state, m), scaled(water(state, m), part), m)), 10);
      const drift = state.drift / 100;
      plot(context, two, {curves: [
        {points: off(1), label: "as recorded"}, {points: off(drift), label: "subtracted"}], log: true,
        low: 0.01, high: 1000, x: "modulation frequency [MHz]", y: "range error [mm]"});
      const at = (part) => rangeError(target(state, 40), scaled(water(state, 40), part), 40);
      return `Range error at 40 MHz: ${at(1).toFixed(2)} mm as recorded, ${at(drift).toFixed(2)} mm after subtraction `
        + `of a reference that is wrong by ${state.drift} %.`;
    },
  },
  "polarization": {
    sliders: ["water", "distance", "targetKeeps", "waterKeeps"],
    single: true,
    draw(context, [, two], state) {
      const share = (keeps, crossed) => (crossed ? 1 - keeps : 1 + keeps) / 2;
      const off = (crossed) => (m) => Math.abs(rangeError(
        scaled(target(state, m), share(state.targetKeeps, crossed)),
        scaled(water(state, m), share(state.waterKeeps, crossed)), m));
      plot(context, two, {curves: [
        {points: sweep(off(false), 10), label: "parallel (VV)"}, {points: sweep(off(true), 10), label: "crossed (VH)"}],
        log: true, low: 0.01, high: 1000, x: "modulation frequency [MHz]", y: "range error [mm]"});
      const gain = share(state.targetKeeps, true) / share(state.targetKeeps, false)
        / (share(state.waterKeeps, true) / share(state.waterKeeps, false));
      return `The crossed analyzer removes ${Math.round(100 * (1 - share(state.targetKeeps, true) / share(state.targetKeeps, false)))} % `
        + `of the target signal and ${Math.round(100 * (1 - share(state.waterKeeps, true) / share(state.waterKeeps, false)))} % of the water signal, `
        + `compared with the parallel analyzer. The ratio of target to water changes ${Number.isFinite(gain) ? `by a factor of ${gain.toPrecision(3)}` : "without limit"}.`;
    },
  },
  "bound": {
    sliders: ["water", "distance", "reflectance", "dwell", "drift"],
    single: true,
    draw(context, [, two], state) {
      const drift = state.drift / 100;
      const noise = (m) => spread(state, m);
      const left = (m) => Math.abs(rangeError(target(state, m), scaled(water(state, m), drift), m));
      const both = (m) => Math.hypot(noise(m), left(m));
      const points = sweep(both, 10);
      const best = points.reduce((a, b) => (b[1] < a[1] ? b : a));
      plot(context, two, {curves: [
        {points: sweep(noise, 10), label: "counting noise", dash: [6, 4]},
        {points: sweep(left, 10), label: "residual water", dash: [2, 3]},
        {points, label: "total", wide: 3}], marks: [best[0]], log: true, low: 0.001, high: 100,
        x: "modulation frequency [MHz]", y: "range error [mm]"});
      return `Smallest total error: ${best[1].toPrecision(2)} mm at ${best[0]} MHz. At this frequency the range is unambiguous over `
        + `${(2 * Math.PI / phasePerMetre(best[0])).toFixed(2)} m.`;
    },
  },
};

// --------------------------------------------------------------------- pages
function build(holder) {
  const figure = FIGURES[holder.dataset.figure], state = {distance: 2, water: 3, reflectance: 0.1};
  const canvas = document.createElement("canvas"), said = document.createElement("p");
  const controls = document.createElement("div");
  canvas.setAttribute("role", "img"); said.setAttribute("aria-live", "polite"); said.className = "said";
  controls.className = "controls";
  function draw() {
    const narrow = canvas.clientWidth < 560, ratio = window.devicePixelRatio || 1;
    canvas.style.height = narrow && !figure.single ? "560px" : "320px";
    canvas.width = canvas.clientWidth * ratio; canvas.height = canvas.clientHeight * ratio;
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    const whole = {left: 62, top: 10, width: canvas.clientWidth - 78, height: canvas.clientHeight - 55};
    said.textContent = figure.draw(context, figure.single ? [null, whole] : boxes(canvas, narrow), state);
    canvas.setAttribute("aria-label", said.textContent);
  }
  for (const name of figure.sliders) {
    const [title, low, high, step, start, write] = SLIDERS[name];
    const label = document.createElement("label"), slider = document.createElement("input");
    const value = document.createElement("output");
    Object.assign(slider, {type: "range", min: low, max: high, step, value: start});
    state[name] = start;
    const show = () => { state[name] = Number(slider.value); value.textContent = write(state[name]); };
    slider.addEventListener("input", () => { show(); draw(); });
    label.append(title, slider, value); controls.append(label); show();
  }
  holder.replaceChildren(canvas, controls, said);
  draw();
  new ResizeObserver(draw).observe(holder);
  new MutationObserver(draw).observe(document.documentElement, {attributeFilter: ["data-theme"]});
}
document.addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll("[data-figure]").forEach(build);
});
})();
