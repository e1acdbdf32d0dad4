// Page of a point cloud or mesh: colors, picks, and lengths with error bounds.

import { Camera, extent, multiplied, projected } from "./camera.js";
import { Closer, unpackedPoints } from "./closer.js";
import { flagRanks, flagTable } from "./colour.js";
import { $, inkOf, made, over, ratioOf, spotOn } from "./dom.js";
import { limitsKey } from "./limits.js";
import { clearedOver, fitted } from "./map.js";
import { annotated, axes, chains, dot, halo, scaleBar } from "./marks.js";
import { Notes } from "./notes.js";
import { Page } from "./page.js";
import { failed, say, showLegend, showReadout } from "./panel.js";
import { distanceOf, lengthAlong, numberAt, seen } from "./picking.js";
import { drawHistogram } from "./plots.js";
import { PointRenderer } from "./points.js";
import { sampled } from "./scene.js";
import { SpaceSource } from "./source.js";
import { listScans, tableOf } from "./scans.js";
import { short, withUnit } from "./text.js";
import { Motion, Pace, turnable } from "./turning.js";

/** Number of points that a moving view draws at first. */
const MOVING = 400000;
/** Largest number of points with which a moving pointer is compared. */
const HOVERED = 250000;
/** Depth of the part that gets further points, in distances of the camera. */
const NEAR = 2;
const TOOLS = [
  { kind: "distance", name: "distance", hint: "Pick two points." },
  { kind: "height", name: "height", hint: "Pick the lower point, then the upper one." },
];
/** Axes of the file in camera directions: right, down, forward. */
const TURNS = {
  "-y": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  y: [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1],
  z: [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1],
};
const AXES = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
const UPWARDS = { "-y": [0, -1, 0], y: [0, 1, 0], z: [0, 0, 1] };

/** @typedef {import("./picking.js").Pick} Pick */

const state = {
  source: new SpaceSource(),
  // Description from the server or the page, and arrays by name.
  scene: /** @type {any} */ (null),
  layerName: "height",
  limits: [0, 1],
  ownLimits: new Map(),
  tables: {},
  tool: null,
  picks: /** @type {Pick[]} */ ([]),
  measurements: /** @type {any[]} */ ([]),
  chosen: null,
  number: 0,
  up: "z",
  cursor: /** @type {Pick | null} */ (null),
  counted: "points",
  places: /** @type {import("./camera.js").Point[]} */ ([]),
};
const camera = new Camera();
const page = new Page(state, {
  draw,
  point: drawPointer,
  limited: () => show(by),
  idle: "Choose what to measure, then pick points.",
  said,
  tools: TOOLS,
});
const notes = new Notes(state.source, {
  view: presentView,
  show: showView,
  place: () =>
    state.cursor && { place: state.cursor.place.map((part, k) => part + state.scene.centre[k]) },
  go: ({ place }) => goTo(place),
  changed: () => page.redraw(),
});
const motion = new Motion(() => page.redraw());
const closer = new Closer(extended);
const pace = new Pace(MOVING, { fewest: 50000, most: 4000000 });
let renderer;
let context;
let pointer;
let by = "height";
/** Names of the scans of a site that are hidden, and a function that hides scans by name. */
let without = /** @type {string[]} */ ([]);
/** @type {(names: string[]) => void} */
let hide = () => {};

/** Return a place of the file as the page has it, relative to the center of all points. */
function relative(place) {
  return place.map((part, k) => part - state.scene.centre[k]);
}

/** Return colors, limits, camera and hidden scans, to be saved. */
function presentView() {
  const { turn, rise, distance, target, orthographic } = camera;
  return {
    layer: by,
    limits: state.ownLimits.get(limitsKey(by)) ?? null,
    camera: { turn, rise, distance, target: [...target], orthographic },
    up: state.up,
    hidden: without,
  };
}

/** Show a saved view. */
function showView({ layer, limits, camera: pose, up, hidden: names }) {
  upwards(up);
  if (layer === "colour" ? state.scene.colour : state.scene.maps.has(layer)) show(layer);
  if (by !== "colour") page.limit(by, limits);
  hide(names);
  Object.assign(camera, pose, { target: [...pose.target] });
  $("ortho").setAttribute("aria-pressed", String(pose.orthographic));
  page.redraw();
}

/** Mark the point nearest to a place of the file, and move it into the middle of the view. */
function goTo(place) {
  const { whole } = state.scene;
  const at = relative(place);
  let [best, least] = [0, Infinity];
  for (let k = 0; k < whole.length; k += 3) {
    const away =
      (whole[k] - at[0]) ** 2 + (whole[k + 1] - at[1]) ** 2 + (whole[k + 2] - at[2]) ** 2;
    if (away < least) [best, least] = [k / 3, away];
  }
  state.cursor = { place: at, corners: [best], weights: [1] };
  camera.target = turned(at);
  readout();
  page.redraw();
}

/**
 * Return a point of the file in camera axes.
 * @returns {import("./camera.js").Point}
 */
function turned(place) {
  const m = TURNS[state.up];
  const along = (row) => m[row] * place[0] + m[4 + row] * place[1] + m[8 + row] * place[2];
  return [along(0), along(1), along(2)];
}

/** Return a direction of the camera in the axes of the file. */
function back(direction) {
  const m = TURNS[state.up];
  return [0, 1, 2].map(
    (column) =>
      m[4 * column] * direction[0] +
      m[4 * column + 1] * direction[1] +
      m[4 * column + 2] * direction[2],
  );
}

function look(canvas) {
  const matrix = multiplied(camera.matrix(canvas.width / canvas.height), TURNS[state.up]);
  const shrinks = !camera.orthographic;
  const focal = shrinks
    ? canvas.height / 2 / Math.tan(Camera.ANGLE / 2)
    : canvas.height / camera.span();
  const size = state.scene.spacing * closer.spacing * 1.5 * 1.13 ** Number($("dot").value);
  return { matrix, shrinks, dot: size * focal };
}

function draw() {
  const { scene } = state;
  if (!scene) return;
  const canvas = $("space");
  fitted(canvas);
  const ratio = ratioOf(canvas);
  const now = look(canvas);
  const { forward, right, up } = camera.frame();
  const light = [0, 1, 2].map((k) => -0.75 * forward[k] - 0.45 * right[k] + 0.5 * up[k]);
  const length = Math.hypot(...light);
  try {
    renderer.draw(context, {
      ...now,
      planes: camera.planes(),
      kind: by === "colour" ? 2 : scene.maps.get(state.layerName).layer.kind === "flags" ? 1 : 0,
      limits: state.limits,
      missing: page.colours.missing,
      ground: page.colours.ground,
      light: back(light.map((part) => part / length)),
      forward: back(forward),
      step: $("edges").checked ? camera.start.size * 0.02 : 0,
      reach: ratio * 1.4,
      most: motion.busy ? Math.round(pace.count) : Infinity,
    });
  } catch (error) {
    failed(error);
    return;
  }
  if (motion.busy) pace.measure(renderer.gl);
  marks(now, canvas, ratio);
  drawPointer();
  const { layer } = scene.maps.get(state.layerName);
  const plain = by === "colour" || layer.kind === "flags";
  $("bar").parentElement.hidden = plain;
  if (!plain) {
    const unit = unitOf(layer);
    page.drawBar(layer, unit);
    $("unit").textContent = unit.unit;
  }
  if (!motion.busy) drawHistogram($("histogram"), state, page.colours);
  canvas.dataset.layer = by;
  document.documentElement.dataset.ready = "yes";
  if (scene.closer && !state.source.saved && !motion.busy) lookCloser(now.matrix).catch(failed);
}

/** Request further points of the part in view; the numbers of picked points stay. */
async function lookCloser(matrix) {
  const { whole, points } = state.scene;
  if (state.picks.length) return;
  // Far behind the middle of the view the drawn points are dense enough.
  const reach = camera.orthographic ? Infinity : NEAR * camera.distance;
  if (await closer.look(whole, points, matrix, reach)) page.redraw();
}

/** Add points of the file in a box to those of the whole cloud; return their number. */
async function extended(box) {
  const { scene } = state;
  const names = scene.layers.map(({ name }) => name);
  const more = unpackedPoints(await state.source.closer(box), names, scene.colour);
  const joined = (all, added, parts = 1) => {
    const few = all.subarray(0, parts * scene.points);
    const out = new all.constructor(few.length + added.length);
    out.set(few);
    out.set(added, few.length);
    return out;
  };
  scene.whole = joined(scene.whole, more.position, 3);
  scene.position = scene.whole;
  scene.own = joined(scene.own, more.colour ?? new Uint8Array(3 * more.count), 3);
  for (const name of names) {
    scene.numbers[name] = joined(scene.numbers[name], more.numbers[name]);
    scene.maps.get(name).values = scene.numbers[name];
  }
  scene.maps.set("height", heights());
  renderer.keep(scene.position, null);
  renderer.own(scene.own);
  valued(scene.maps.get(state.layerName));
  // Numbers of added points belong to others now.
  state.picks = [];
  if (state.cursor && state.cursor.corners[0] >= scene.points) state.cursor = null;
  return more.count;
}

/** Draw the overlay for the point under the pointer. */
function drawPointer() {
  const canvas = $("space");
  const { matrix } = look(canvas);
  const at = state.cursor && projected(matrix, state.cursor.place, canvas.width, canvas.height);
  const ink = clearedOver(pointer, canvas, at);
  if (at) dot(ink, at, 5 * ratioOf(canvas), page.colours, true);
}

function unitOf(layer) {
  if (layer.unit !== "m") return { unit: layer.unit, factor: 1 };
  const most = Math.max(...state.limits.map(Math.abs));
  return most < 0.5 ? { unit: "mm", factor: 1e3 } : { unit: "m", factor: 1 };
}

function marks({ matrix }, canvas, ratio) {
  const { colours } = page;
  const spotOf = (pick) => projected(matrix, pick.place, canvas.width, canvas.height);
  chains(context, state, spotOf, ratio, colours);
  const noted = ({ place }) => spotOf({ place: relative(place) });
  annotated(context, notes.content.annotations, noted, ratio, colours);
  if (document.activeElement === canvas && canvas.matches(":focus-visible")) cross(canvas, ratio);
  axes(
    context,
    camera,
    Object.entries(AXES).map(([name, axis]) => [name, turned(axis)]),
    ratio,
    colours,
  );
  if (camera.orthographic)
    state.bar = scaleBar(context, canvas.height / camera.span(), ratio, colours);
}

/** The center of the view, where Enter picks. */
function cross(canvas, ratio) {
  const [x, y] = [canvas.width / 2, canvas.height / 2];
  halo(context, ratio, page.colours, () => {
    context.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ]) {
      context.moveTo(x + 4 * ratio * dx, y + 4 * ratio * dy);
      context.lineTo(x + 13 * ratio * dx, y + 13 * ratio * dy);
    }
  });
}

function home() {
  const { whole: position, points } = state.scene;
  const some = sampled(
    Array.from({ length: points }, (_, i) => i),
    6000,
  )
    .map((i) => turned(position.subarray(3 * i, 3 * i + 3)))
    .filter((place) => place.every(Number.isFinite));
  const { target, size, inside } = extent(some);
  camera.home({ target, size });
  state.places = inside;
  fit();
}

function fit() {
  const { clientWidth, clientHeight } = $("space");
  if (clientHeight) camera.fit(state.places, clientWidth / clientHeight);
}

/** Return the heights of all points, along the selected vertical axis. */
function heights() {
  const { whole: position, centre } = state.scene;
  const up = UPWARDS[state.up];
  const values = new Float32Array(position.length / 3);
  for (let i = 0; i < values.length; i += 1) {
    values[i] = [0, 1, 2].reduce((sum, k) => sum + up[k] * (position[3 * i + k] + centre[k]), 0);
  }
  return { layer: { name: "height", label: "Height", unit: "m", kind: "range" }, values };
}

function limitsOf({ layer, values }) {
  if (layer.kind === "flags") return [0, 255];
  if (state.ownLimits.has(layer.name)) return state.ownLimits.get(layer.name);
  const some = sampled(values, 60000)
    .filter(Number.isFinite)
    .sort((a, b) => a - b);
  if (!some.length) return [0, 1];
  const [low, high] = [0.01, 0.985].map(
    (share) => some[Math.min(some.length - 1, Math.floor(share * some.length))],
  );
  if (layer.kind === "signed")
    return [-1, 1].map((sign) => sign * (Math.max(Math.abs(low), Math.abs(high)) || 1e-6));
  if (layer.kind === "amplitude") return [0, high || 1];
  const room = (high - low || Math.abs(high) || 1e-3) * 0.03;
  return [low - room, high + room];
}

/** Store the displayed values of all points on the graphics card. */
function valued({ layer, values }) {
  renderer.numbers(layer.kind === "flags" ? flagRanks(values, state.scene.flags) : values);
}

function show(name) {
  const { scene } = state;
  by = name;
  if (name !== "colour") {
    state.layerName = name;
    const map = scene.maps.get(name);
    state.limits = limitsOf(map);
    const flags = map.layer.kind === "flags";
    renderer.colours(flags ? flagTable(scene.flags, "#2c7f62") : state.tables[map.layer.kind]);
    valued(map);
    $("legend").hidden = !flags;
    if (flags) showLegend(map.values, scene.flags);
  } else $("legend").hidden = true;
  for (const button of $("colours").children)
    button.setAttribute("aria-pressed", String(button.dataset.layer === name));
  page.redraw();
}

function places(place) {
  const { centre, size } = state.scene;
  // As many digits as the received numbers have.
  const digits = Math.min(Math.max(Math.ceil(-Math.log10(Math.max(...size) * 2 ** -23)), 0), 6);
  return place.map((part, k) => (part + centre[k]).toFixed(Math.min(digits, 5)).replace("-", "−"));
}

function bounded(value, bound) {
  if (!Number.isFinite(bound)) return `${withUnit(value, "m", 5)} (error not known)`;
  const factor = Math.abs(value) < 10 ? 1e3 : 1;
  const error = bound * factor;
  const digits = Math.min(Math.max(0, 1 - Math.floor(Math.log10(error || 1))), 6);
  return `${(value * factor).toFixed(digits).replace("-", "−")} mm ± at most ${error.toFixed(digits)} mm`.replaceAll(
    "mm",
    factor === 1 ? "m" : "mm",
  );
}

function readout() {
  const { scene, cursor } = state;
  const rows = [];
  const add = (term, text, kind = "") => rows.push([term, text, kind]);
  if (cursor) {
    const [x, y, z] = places(cursor.place);
    add("x", `${x} m`, "big");
    add("y", `${y} m`, "big");
    add("z", `${z} m`, "big");
    const { name, visit } = scene.scans[scene.numbers.scan?.[cursor.corners[0]]] ?? {};
    if (name) add("scan", `${name}, visit ${visit}`);
    for (const { layer, values } of scene.maps.values()) {
      if (layer.kind === "flags" || (layer.kind === "hidden" && layer.name !== "common")) continue;
      if (layer.name === "height") continue;
      const value = numberAt(values, cursor);
      const label = layer.name === "common" ? "shared part" : layer.label.toLowerCase();
      add(
        label,
        layer.unit ? withUnit(value, layer.unit, layer.kind === "error" ? 2 : 4) : short(value, 4),
      );
    }
    const sigmas = ["x", "y", "z"].map((axis) => numberAt(scene.numbers[`sigma_${axis}`], cursor));
    if (sigmas.every(Number.isFinite))
      add("of x, y, z", sigmas.map((part) => short(part * 1e3, 2)).join(", ") + " mm");
  }
  if (!cursor) {
    const words = matchMedia("(pointer: coarse)").matches
      ? "Tap a point."
      : "Point at a point, or press Enter for what is in the middle of the view.";
    showReadout([["none yet", words, "words"]], []);
    return;
  }
  const flags =
    cursor && scene.numbers.flags
      ? scene.flags.filter((flag) => scene.numbers.flags[cursor.corners[0]] & flag.mask)
      : [];
  showReadout(rows, flags);
}

/**
 * Measure between two picks.
 * @param {string} kind
 * @param {Pick[]} picks
 */
function measured(kind, [one, other]) {
  const { scene } = state;
  const up = UPWARDS[state.up];
  const { value, bound } =
    kind === "height" ? lengthAlong(scene, one, other, up) : distanceOf(scene, one, other);
  const rests = [];
  if (kind === "distance") {
    const apart = other.place.map((part, k) => part - one.place[k]);
    const high = apart.reduce((sum, part, k) => sum + part * up[k], 0);
    const digits =
      bound > 0 ? Math.min(Math.max(Math.ceil(Math.log10(value / bound)) + 1, 1), 6) : 5;
    rests.push(
      `level ${withUnit(Math.sqrt(Math.max(value ** 2 - high ** 2, 0)), "m", digits)}`,
      `height ${withUnit(high, "m", digits)}`,
    );
  }
  const where = [one, other].map((pick) => `(${places(pick.place).join(", ")})`).join(" to ");
  return { value, bound: Number.isFinite(bound) ? bound : null, rests: rests.join(" · "), where };
}

function picked(pick) {
  state.cursor = pick;
  readout();
  const tool = page.tool();
  if (tool) {
    state.picks.push(pick);
    if (state.picks.length === 2) {
      const { picks } = state;
      state.picks = [];
      const found = measured(tool.kind, picks);
      page.keep({ kind: tool.kind, picks, found, file: state.scene.name });
      page.hint(tool.hint);
    } else page.hint("1 of 2 picked.");
  }
  page.redraw();
}

function said({ kind, found }) {
  const words = [kind, found.rests].filter(Boolean).join(" · ");
  return { main: bounded(found.value, found.bound ?? NaN), words };
}

function asRows() {
  return state.measurements.map(({ number, name, kind, file, found }) => ({
    number,
    name,
    kind,
    value: found.value,
    standard_uncertainty_at_most: found.bound,
    unit: "m",
    file,
    where_m: found.where,
  }));
}

function asText() {
  const { scene } = state;
  const lines = [
    `${scene.title} (${scene.name})`,
    "± is a bound of one standard uncertainty: the file does not say how errors of two points correlate.",
  ];
  for (const kept of state.measurements)
    lines.push(
      "",
      `${kept.number}. ${[kept.name, kept.kind].filter(Boolean).join(": ")}: ${bounded(kept.found.value, kept.found.bound ?? NaN)}`,
      `   ${kept.found.where} m`,
    );
  return `${lines.join("\n")}\n`;
}

async function picture() {
  const { layer } = state.scene.maps.get(state.layerName);
  const plain = by === "colour" || layer.kind === "flags";
  const words = [$("subtitle").textContent];
  if (!camera.orthographic) words.push("In perspective: no scale.");
  for (const { number, kind, found } of state.measurements) {
    words.push(`${number}: ${kind} ${bounded(found.value, found.bound ?? NaN)}`);
  }
  draw();
  await page.picture($("space"), "view", words, plain ? null : page.bar(layer, unitOf(layer)));
}

function seenAt(x, y) {
  const canvas = $("space");
  const { width, height } = canvas;
  const { position, faces } = state.scene;
  const now = look(canvas);
  const shape = { position, faces, count: position.length / 3 };
  return seen(shape, now.matrix, { x, y, width, height }, now);
}

function seenBy(event) {
  return seenAt(...spotOn($("space"), event));
}

/** Pick the point at the center of the view. */
function middle() {
  const pick = seenAt($("space").width / 2, $("space").height / 2);
  if (pick) picked(pick);
  else page.hint("Nothing is in the middle of the view.", true);
}

/** Show everything from a given side. */
function from(side) {
  side.call(camera);
  fit();
}

const KEYS = {
  r: home,
  o: () => page.orthographic(camera),
  a: () => page.limit(state.layerName),
  f: () => from(camera.straight),
  t: () => from(camera.above),
  c: () => notes.saveView(),
  n: () => notes.annotate(),
  d: () => page.otherTheme(),
  s: () => page.save(),
  p: () => picture().catch(failed),
  "?": () => $("keys").showModal(),
  "+": () => camera.zoom(0.8),
  "-": () => camera.zoom(1.25),
  Escape: () => page.choose(null),
  Enter: middle,
};

function arrow(into, [dx, dy], { shiftKey }) {
  if (into !== $("space")) return false;
  if (shiftKey) camera.pan(dx * 0.05, dy * 0.05);
  else camera.orbit(dx * 0.08, dy * 0.08);
  motion.moved();
  return true;
}

/** Search the point under the pointer, unless the search would be slow. */
function hover(event) {
  const { scene } = state;
  if (!scene || (scene.faces ?? scene.position).length / 3 > HOVERED) return;
  const pick = seenBy(event);
  if (!pick) return;
  state.cursor = pick;
  readout();
  page.repoint();
}

function wired() {
  turnable($("space"), camera, {
    moved: () => motion.moved(),
    hover,
    pick: (event) => {
      const pick = seenBy(event);
      if (pick) picked(pick);
    },
    home,
  });
  page.wire({
    clicks: {
      save: KEYS.s,
      theme: KEYS.d,
      help: KEYS["?"],
      ortho: KEYS.o,
      front: KEYS.f,
      top: KEYS.t,
      home: KEYS.r,
      picture: KEYS.p,
      auto: KEYS.a,
    },
    keys: KEYS,
    arrow,
    numbered: (at) => {
      const button = $("colours").children[at];
      if (button) show(button.dataset.layer);
      return Boolean(button);
    },
    texts: {
      text: asText,
      rows: asRows,
      content: () => ({
        file: state.scene.name,
        title: state.scene.title,
        measurements: state.measurements,
      }),
    },
  });
  const redraw = () => page.redraw();
  for (const name of ["focus", "blur"]) $("space").addEventListener(name, redraw);
  for (const id of ["dot", "edges"]) $(id).addEventListener("input", redraw);
  $("up").addEventListener("input", (event) => {
    upwards(event.target.value);
    show(by);
  });
  new ResizeObserver(redraw).observe(/** @type {Element} */ (document.querySelector("main")));
}

/** Set the vertical axis of the file. */
function upwards(axis) {
  if (axis === state.up) return;
  state.up = axis;
  $("up").value = axis;
  state.scene.maps.set("height", heights());
  home();
}

/** Load all arrays of the file. */
async function loaded() {
  const { source } = state;
  const scene = await source.scene();
  scene.position = await source.numbers("position");
  scene.faces = scene.mesh ? await source.numbers("faces", Uint32Array) : null;
  scene.whole = scene.position;
  renderer.keep(scene.position, scene.faces);
  scene.own = scene.colour
    ? await source.numbers("colour", Uint8Array)
    : new Uint8Array(scene.position.length);
  renderer.own(scene.own);
  state.scene = scene;
  state.up = scene.up;
  $("up").value = scene.up;
  scene.numbers = {};
  scene.maps = new Map([["height", heights()]]);
  for (const layer of scene.layers) {
    const values = await source.numbers(layer.name);
    scene.numbers[layer.name] = values;
    scene.maps.set(layer.name, { layer, values });
  }
  return scene;
}

/** Return a text on the shown fraction of the file. */
function amount({ mesh, triangles, points, total }) {
  const number = (count) => count.toLocaleString("en");
  if (mesh) return `${number(triangles)} triangles, ${number(points)} vertices`;
  return points < total
    ? `${number(points)} of ${number(total)} points`
    : `${number(points)} points`;
}

function buttons(scene) {
  const labels = [...scene.maps.values()]
    .filter(({ layer }) => layer.kind !== "hidden")
    .map(({ layer }) => [layer.name, layer.label]);
  if (scene.colour) labels.push(["colour", scene.scans.length ? "Scan" : "Color"]);
  return labels.map(([name, label], at) => {
    const button = made("button", { type: "button", textContent: label, title: `Key ${at + 1}` });
    button.dataset.layer = name;
    button.addEventListener("click", () => show(name));
    return button;
  });
}

/** Draw and pick only points of scans that are shown. */
function hidden(numbers) {
  const { scene } = state;
  const { whole } = scene;
  const { scan } = scene.numbers;
  without = [...numbers].map((number) => scene.scans[number].name);
  scene.position = numbers.size
    ? whole.map((value, at) => (numbers.has(scan[Math.floor(at / 3)]) ? NaN : value))
    : whole;
  renderer.keep(scene.position, scene.faces);
  page.redraw();
}

async function opened() {
  const scene = await loaded();
  const size = scene.size.map((part) => withUnit(part, "m", 3)).join(" × ");
  const subtitle = [scene.name, amount(scene), size, scene.simulated && "simulated"];
  page.titled(scene, subtitle.filter(Boolean).join(" · "));
  $("colours").replaceChildren(...buttons(scene));
  if (scene.scans.length) hide = listScans(scene.scans, hidden);
  tableOf(scene.pairs);
  $("space").setAttribute(
    "aria-label",
    `${amount(scene)} in space, ${size}. Arrow keys turn, Enter picks what is in the middle.`,
  );
  home();
  if (scene.numbers.change) return (show("change"), readout());
  const numbers = scene.numbers.uncertainty && !scene.mesh ? "uncertainty" : "height";
  show(scene.colour ? "colour" : numbers);
  readout();
}

async function main() {
  renderer = new PointRenderer();
  renderer.lost = () => say("The GPU was lost; reload the page.");
  context = inkOf($("space"), { opaque: true });
  pointer = inkOf(over($("space")));
  state.tables.hidden = state.tables.range;
  page.theme();
  wired();
  await opened();
  state.record.open(state.scene.name);
  await notes.open(state.scene.name).catch(failed);
  page.redraw();
  document.documentElement.dataset.complete = "yes";
}

state.views = { camera, seenBy, seenAt, turned };
Object.assign(window, { amulor: state });
main().catch(failed);
