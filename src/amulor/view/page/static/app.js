// Page of a scan: the view, the pixel under the pointer, and the links between all panels.

import { boxContent, boxFrom, boxText, ClipBox, inside } from "./clip.js";
import { CloudView } from "./cloud.js";
import { $, inkOf, made } from "./dom.js";
import { limitsKey } from "./limits.js";
import { Live } from "./live.js";
import { fitted, MapView } from "./map.js";
import { Notes } from "./notes.js";
import { Page } from "./page.js";
import { failed, say, showLegend, showReadout, unsay } from "./panel.js";
import { download } from "./picture.js";
import {
  along,
  drawHistogram,
  drawProfile,
  drawSpectrum,
  halfProfile,
  profileOf,
} from "./plots.js";
import { Products } from "./products.js";
import { Renderer } from "./renderer.js";
import { ROUNDING, sampled, Scene } from "./scene.js";
import { printable } from "./sheet.js";
import { source } from "./source.js";
import { Stage } from "./stage.js";
import { scaled, short, withError, withUnit } from "./text.js";
import * as tools from "./tools.js";

/** @typedef {[number, number]} Pixel row and column of the scan */

const state = {
  source: source(),
  layerName: "range",
  raw: false,
  limits: [0, 1],
  ownLimits: new Map(),
  cursor: /** @type {Pixel | null} */ (null),
  pinned: /** @type {Pixel | null} */ (null),
  follow: true,
  tool: null,
  picks: /** @type {Pixel[]} */ ([]),
  region: /** @type {number[] | null} */ (null),
  corner: /** @type {Pixel | null} */ (null),
  section: /** @type {Pixel[] | null} */ (null),
  measurements: /** @type {any[]} */ ([]),
  chosen: null,
  number: 0,
  average: 0,
  profileKind: "row",
  profileLayer: "range",
  spectrum: /** @type {any} */ (null),
  digest: "",
  annotations: /** @type {import("./notes.js").Annotation[]} */ ([]),
  contour: 0,
  look: { light: [0, 0, 0], relief: 1, contour: 0, raw: false },
  tables: {},
};
const page = new Page(state, {
  draw,
  point: drawPointer,
  limited,
  idle: "Choose what to measure, then pick it in the map or in space.",
  said,
  themed,
  tools: tools.TOOLS,
  needs: (view) => stage.need(view),
});
const views = {};
const stage = new Stage(resized);
const clip = new ClipBox(() => page.redraw());

const notes = new Notes(state.source, {
  view: presentView,
  show: (view) => showView(view).catch(failed),
  place: () => {
    const [row, column] = state.cursor ?? [];
    return row === undefined ? null : { channel: state.scene.channel, row, column };
  },
  go: ({ row, column }) => {
    state.pinned = [row, column];
    point([row, column]);
  },
  changed: () => page.redraw(),
});

/** Return map, limits, camera and clip box, to be saved. */
function presentView() {
  const { turn, rise, distance, target, orthographic } = views.cloud.camera;
  return {
    channel: state.scene.channel,
    layer: state.layerName,
    limits: state.ownLimits.get(limitsKey(state.layerName)) ?? null,
    camera: { turn, rise, distance, target: [...target], orthographic },
    clip: boxContent(clip.box),
  };
}

/** Show a saved view. */
async function showView({ channel, layer, limits, camera, clip: box }) {
  if (channel !== state.scene.channel && state.scene.channels.includes(channel))
    await opened(channel);
  const raw = layer.endsWith("_before");
  if (raw !== state.raw) await water(raw);
  if (state.scene.byName.has(layer)) await show(layer);
  page.limit(state.layerName, limits);
  clip.set(boxFrom(box));
  clip.show(Boolean(box));
  Object.assign(views.cloud.camera, camera, { target: [...camera.target] });
  $("ortho").setAttribute("aria-pressed", String(camera.orthographic));
  page.redraw();
}

/** Put the surface in view again, and draw everything at its new size. */
function resized() {
  views.cloud.refit();
  thumbnailsLater();
  page.redraw();
}

function draw() {
  const { scene } = state;
  const { colours } = page;
  if (!scene?.maps.has(state.layerName)) return;
  light();
  state.annotations = notes.content.annotations;
  try {
    for (const name of ["map", "cloud"]) {
      if (!stage.shows(name)) continue;
      fitted(views[name].canvas);
      views[name].draw(state, colours);
    }
  } catch (error) {
    failed(error);
    return;
  }
  const layer = scene.byName.get(state.layerName);
  if (layer.kind !== "flags") {
    const unit = unitOf(layer);
    page.drawBar(layer, unit);
    const nothing = scene.nothing(state.layerName);
    $("unit").textContent = nothing ? `${unit.unit}: 0 within rounding` : unit.unit;
  }
  if (stage.shows("plots")) {
    drawProfile($("profile"), state, colours);
    drawHistogram($("histogram"), state, colours);
    drawSpectrum($("spectrum"), state, colours);
    state.live?.traces.draw();
  }
  document.documentElement.dataset.ready = "yes";
}

/** Whether the view in space has moved, so that it is drawn again. */
let turned = false;
/** Pixel of the overlays as they are drawn. */
let pointed = /** @type {Pixel | null} */ (null);

/** Draw overlays that depend on the pixel under the pointer, and a view that has moved. */
function drawPointer() {
  if (!state.scene?.maps.has(state.layerName)) return;
  if (stage.shows("cloud")) {
    if (turned || views.cloud.motion.busy) {
      fitted(views.cloud.canvas);
      views.cloud.draw(state, page.colours);
    } else views.cloud.point(state, page.colours);
  }
  // Nothing else follows a view that turns around the same pixel.
  if (turned && state.cursor === pointed) {
    turned = false;
    return;
  }
  turned = false;
  pointed = state.cursor;
  if (stage.shows("map")) views.map.point(state, page.colours);
  if (stage.shows("plots")) drawProfile($("profile"), state, page.colours);
}

/** Return a unit that gives the limits of a map few digits. */
function unitOf({ kind, unit }) {
  if (kind === "range") return { unit, factor: 1 };
  return scaled(Math.max(...state.limits.map(Math.abs)), unit);
}

function themed({ ground, missing }) {
  Object.assign(state.look, { ground, missing });
  state.live?.draw();
}

function light() {
  const on = $("light").checked;
  const turn = (Number($("light-turn").value) * Math.PI) / 180;
  const rise = (Number($("light-rise").value) * Math.PI) / 180;
  state.look.light = on
    ? [Math.sin(turn) * Math.cos(rise), -Math.cos(turn) * Math.cos(rise), -Math.sin(rise)]
    : [0, 0, 0];
  state.look.relief = 1;
  state.look.contour = Number($("contour").value);
  state.look.raw = shownRaw();
  state.look.averaged = $("averaged").checked;
  state.look.clip = clip.box;
}

function shownRaw() {
  return state.raw && state.scene.byName.has(`${state.scene.main}_before`);
}

/** Return the noise of means over neighbors, and the slope that this noise causes. */
function noiseOf(reach) {
  const { scene } = state;
  const middle = (name) => {
    const some = sampled(scene.maps.get(name)?.values ?? [], 4000).filter(Number.isFinite);
    return some.sort((a, b) => a - b)[some.length >> 1];
  };
  const total = middle("uncertainty");
  const common = middle("common") || 0;
  const wide = 2 * reach + 1;
  const noise = Math.sqrt(Math.max(total ** 2 - common ** 2, 0)) / wide;
  // Two such means, two pixels apart, share some of their pixels.
  const apart = 1 - Math.max(wide - 2, 0) / wide;
  const slope = Math.atan((Math.sqrt(2 * apart) * noise) / (2 * scene.spacing.column));
  return { wide, noise, degrees: (slope * 180) / Math.PI };
}

/** Choose a smoothing in which noise causes no visible relief; without one, no shading. */
function calm() {
  const { scene } = state;
  if (!scene.maps.has("uncertainty")) return;
  const most = Number($("reach").max);
  let reach = 1;
  while (reach < most && noiseOf(reach).degrees > 6) reach += 1;
  $("reach").value = String(reach);
  $("light").checked = noiseOf(reach).degrees <= 12;
  // Noise of single pixels steeper than this would hide all relief.
  $("averaged").checked = noiseOf(0).degrees > 35 && noiseOf(reach).degrees <= 12;
  for (const name of [scene.main, "range_before"]) scene.smooth(name, reach);
}

/** Describe next to the shading option what shading can show. */
function lightNote() {
  if (!state.scene.maps.has("uncertainty")) return;
  const { wide, noise, degrees } = noiseOf(Number($("reach").value));
  const lit = state.scene.byName.get(state.layerName).kind === "range";
  $("light-note").textContent =
    `${lit ? "Light and contours" : "Light is for the range map; contours"} on means of ${wide} × ${wide} pixels, noise ${withUnit(noise, "m", 2)}: slopes under ${short(Math.min(2 * degrees, 90), 2)}° may be noise.`;
  $("light-note").dataset.slope = String(degrees);
}

/** Return a description of the view, for the line below the title. */
function subtitle(scene) {
  const strided = scene.stride > 1 ? `, every ${scene.stride}th row and column drawn` : "";
  const parts = [
    scene.name,
    `${scene.rows} × ${scene.columns} pixels${strided}`,
    scene.simulated ? "simulated" : "measured",
    `ranges in water of group index ${Number(scene.group_index.toPrecision(5))}`,
  ];
  if (scene.frequencies.length) parts.push(frequencies(scene.frequencies));
  return parts.join(" · ");
}

function channels(scene) {
  $("channel-field").hidden = scene.channels.length < 2;
  const option = (name) => new Option(name, name, name === scene.channel, name === scene.channel);
  $("channel").replaceChildren(...scene.channels.map(option));
}

/** Update the switch between the maps with and without the water signal. */
function switches(scene) {
  const [without, within] = $("water").querySelectorAll("button");
  const both = scene.byName.has("range") && scene.byName.has("range_before");
  within.disabled = !scene.byName.has("range_before");
  without.disabled = !scene.byName.has("range");
  if (!both) state.raw = !scene.byName.has("range");
  without.textContent = scene.water_in ? "Water in" : "Water removed";
  within.hidden = scene.water_in;
  $("water").title = both ? "" : (scene.notes[0] ?? "");
}

async function opened(channel) {
  say("");
  const scene = state.scene ?? new Scene(state.source, state.renderer);
  await scene.open(channel);
  state.scene = scene;
  page.titled(scene, subtitle(scene));
  // A saved page has no pixels between those that it draws.
  $("average").closest("label").hidden = state.source.saved && scene.stride > 1;
  channels(scene);
  switches(scene);
  contours();
  tabs();
  stage.arrange({ across: scene.wide, down: scene.high * scene.aspect });
  await show(
    scene.byName.has(state.layerName) ? state.layerName.replace("_before", "") : scene.main,
  );
  // The view of a running scan grows with it, until the user moves the view.
  if (!views.placed || (state.live && !shownRaw() && !views.cloud.moved())) {
    views.cloud.home(scene);
    views.placed = true;
  }
  if (!state.cursor) await point([Math.floor(scene.rows / 2), Math.floor(scene.columns / 2)]);
  const rest = [...scene.byName.values()].filter(
    (layer) => layer.kind !== "hidden" || layer.name === "common" || layer.name.startsWith("steps"),
  );
  for (const layer of rest) await scene.load(layer.name);
  if (!state.calmed) calm();
  state.calmed = true;
  thumbnails();
  lightNote();
  readout();
  page.redraw();
}

function frequencies(all) {
  const text = (value) => `${short(value / 1e6, 4)}`;
  return all.length === 1
    ? `${text(all[0])} MHz`
    : `${all.length} frequencies, ${text(all[0])} to ${text(all.at(-1))} MHz`;
}

function contours() {
  const { scene } = state;
  const [low, high] = scene.limits(scene.main);
  const span = high - low;
  const size = 10 ** Math.floor(Math.log10(span || 1));
  const steps = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1]
    .map((part) => part * size)
    .filter((step) => span / step <= 60 && span / step >= 2);
  $("contour").replaceChildren(
    new Option("off", "0"),
    ...steps.map((step) => new Option(withUnit(step, "m", 2), String(step))),
  );
}

const MAIN = [
  ...["range", "amplitude", "uncertainty", "bias", "shift", "wrong", "flags"],
  ...["deviation", "significant", "deviation_uncertainty"],
];

function tabs() {
  const { scene } = state;
  const names = MAIN.filter((name) => scene.byName.has(name) || scene.byName.has(`${name}_before`));
  state.tabs = names;
  $("tabs").replaceChildren(
    ...names.map((name, at) => {
      const canvas = made("canvas", { ariaHidden: "true" });
      const { label } = scene.byName.get(name) ?? scene.byName.get(`${name}_before`);
      const text = made("span", { textContent: label });
      const button = made("button", { type: "button", title: `Key ${at + 1}` }, canvas, text);
      button.role = "tab";
      button.dataset.layer = name;
      button.addEventListener("click", () => show(name).catch(failed));
      return button;
    }),
  );
}

function thumbnails() {
  const { scene } = state;
  for (const button of $("tabs").children) {
    const name = actual(button.dataset.layer);
    if (!scene.maps.has(name)) continue;
    const canvas = button.querySelector("canvas");
    fitted(canvas);
    const { width, height } = canvas;
    const tall = scene.high * scene.aspect;
    // The whole width and the middle of the height, to fill the panel.
    const per = Math.min(scene.wide / width, tall / height);
    const parts = scene.uniforms(name, limitsOf(name), {
      ...state.look,
      contour: 0,
      light: [0, 0, 0],
    });
    const step = [per, per / scene.aspect];
    parts.set.uView = [
      "4f",
      (scene.wide - width * step[0]) / 2,
      (scene.high - height * step[1]) / 2,
      ...step,
    ];
    state.renderer.drawMap(inkOf(canvas, { plot: true }), parts);
  }
}

/** Return the map of a tab: before or after rejection, according to the switch. */
function actual(name) {
  const { scene } = state;
  const before = `${name}_before`;
  if (!scene.byName.has(name)) return before;
  return state.raw && scene.byName.has(before) ? before : name;
}

function limitsOf(name) {
  const key = limitsKey(name);
  if (state.ownLimits.has(key)) return state.ownLimits.get(key);
  const { scene } = state;
  const own = scene.limits(name);
  if (key === name || !scene.maps.has(key)) return own;
  // Both maps have equal limits, so that the switch shows how the shape changes.
  const after = scene.limits(key);
  const shift = key === "range" ? (own[0] + own[1] - after[0] - after[1]) / 2 : 0;
  const middle = sampled(scene.maps.get(name).values, 4000)
    .filter(Number.isFinite)
    .sort((a, b) => a - b);
  const centre =
    key === "range" && middle.length
      ? middle[middle.length >> 1] - (after[0] + after[1]) / 2
      : shift;
  return after.map((value) => value + centre);
}

async function show(name) {
  const { scene } = state;
  const wanted = actual(name.replace("_before", ""));
  await scene.load(wanted);
  if (wanted.endsWith("_before") && scene.byName.has("range_before"))
    await scene.load("range_before");
  if (wanted === "significant") await scene.load("deviation");
  state.layerName = wanted;
  const layer = scene.byName.get(wanted);
  if (layer.kind !== "flags") state.profileLayer = wanted;
  state.limits = limitsOf(wanted);
  for (const button of $("tabs").children) {
    const selected = button.dataset.layer === name.replace("_before", "");
    button.setAttribute("aria-selected", String(selected));
    // Without a scroll of the page, which the user may be reading elsewhere.
    const { parentElement: list, offsetLeft: left, offsetWidth: wide } = button;
    if (selected) list.scrollLeft = left - list.offsetLeft - (list.clientWidth - wide) / 2;
  }
  const flags = layer.kind === "flags";
  for (const id of ["light", "light-turn", "light-rise"]) $(id).disabled = layer.kind !== "range";
  for (const hidden of [$("bar").parentElement, $("auto"), $("narrow")]) hidden.hidden = flags;
  $("legend").hidden = !flags;
  if (flags) showLegend(scene.maps.get(wanted).values, scene.flags);
  for (const button of $("water").querySelectorAll("button"))
    button.setAttribute("aria-pressed", String((button.dataset.raw === "yes") === state.raw));
  $("map").setAttribute(
    "aria-label",
    `Map of the ${layer.label.toLowerCase()}, ${scene.rows} rows and ${scene.columns} columns. Arrow keys move the pixel.`,
  );
  if (Object.keys(state.tables).length) thumbnails();
  lightNote();
  readout();
  page.redraw();
}

let asked = 0;

async function point(pixel) {
  if (pixel === undefined) return page.redraw();
  state.cursor = pixel ?? state.pinned ?? state.cursor;
  readout();
  page.repoint();
  const { scene, cursor } = state;
  if (!scene.spectrum || !cursor) return undefined;
  asked += 1;
  const own = asked;
  await new Promise((done) => setTimeout(done, 60));
  if (own !== asked) return undefined;
  try {
    const found = await state.source.spectrum(scene.channel, ...cursor);
    if (own === asked) state.spectrum = found;
  } catch (error) {
    if (!state.live) failed(error);
  }
  $("spectrum-title").textContent = state.spectrum?.frequency.length === 1 ? "Phasors" : "Spectrum";
  if (stage.shows("plots")) drawSpectrum($("spectrum"), state, page.colours);
  return undefined;
}

function readout() {
  const { scene, cursor } = state;
  if (!scene || !cursor) return;
  const get = (name) => scene.value(name, ...cursor);
  const rows = [];
  const range = get(scene.main);
  const error = get("uncertainty");
  const raw = get("range_before");
  const waterIn = scene.main === "range" && shownRaw();
  const shape = waterIn ? "range_before" : scene.main;
  const add = (term, text, kind = "") => rows.push([term, text, kind]);
  $("where").textContent = `row ${cursor[0]}, column ${cursor[1]}`;
  const moved = () => `${short(raw * 1e3, 5)} mm (${signed(raw - range)})`;
  if (waterIn) {
    add("range", Number.isFinite(raw) ? `${short(raw * 1e3, 5)} mm, water in` : "none", "big");
    add("water removed", Number.isFinite(range) ? withError(range, error, "m") : "none");
    if (Number.isFinite(raw - range)) add("moved by water", signed(raw - range));
  } else if (Number.isFinite(range)) {
    add(
      "range",
      Number.isFinite(error) ? withError(range, error, "m") : withUnit(range, "m", 5),
      "big",
    );
    if (scene.error_unknown) add("error", "unknown");
    if (Number.isFinite(get("common"))) add("shared part", withUnit(get("common"), "m", 2));
    if (Number.isFinite(get("bias")))
      add(
        "bias left",
        Math.abs(get("bias")) < ROUNDING ? "0 within rounding" : withUnit(get("bias"), "m", 2),
      );
    if (Number.isFinite(raw) && scene.main === "range") add("water in", moved());
    const sure = Number.isFinite(get("significant")) ? "significant" : "not significant";
    if (Number.isFinite(get("deviation")))
      add(
        "deviation",
        `${withError(get("deviation"), get("deviation_uncertainty"), "m")}, ${sure}`,
      );
  } else add("range", "none", "big");
  const amplitude = get(
    waterIn && scene.byName.has("amplitude_before") ? "amplitude_before" : "amplitude",
  );
  if (Number.isFinite(amplitude)) add("amplitude", withUnit(amplitude, "V", 3));
  const place = scene.point(...cursor, shape);
  if (place)
    add(
      "place",
      place.map((part) => short(part * 1e3, Math.abs(part) >= 1 ? 5 : 4)).join(", ") + " mm",
    );
  const flags = scene.reasons(
    ...cursor,
    scene.maps.has("flags") && !waterIn ? "flags" : "flags_before",
  );
  // A new row of a running scan has ranges at once, errors and flags after recomputation.
  const fresh =
    Number.isFinite(waterIn ? raw : range) && flags.some((flag) => flag.name === "missing");
  if (fresh) rows.splice(1, 0, ["error", "being estimated", ""]);
  showReadout(rows, fresh ? [] : flags);
}

function signed(value) {
  const text = withUnit(value, "m", 3);
  return value > 0 ? `+${text}` : text;
}

async function picked(pixel) {
  state.pinned = pixel;
  point(pixel);
  const tool = page.tool();
  if (!tool || tool.region) return;
  if (state.raw) {
    page.hint("Measuring is on the corrected picture: the water signal is removed from it.", true);
    return;
  }
  const place = state.scene.point(...pixel);
  if (place && !inside(place, clip.box)) {
    page.hint("This pixel is outside the clip box.", true);
    return;
  }
  const { picks } = state;
  const [first] = picks;
  const again = first?.[0] === pixel[0] && first[1] === pixel[1];
  const closes = tool.least && picks.length >= tool.least && again;
  if (!closes) picks.push(pixel);
  if (closes || picks.length === tool.points) await finish();
  else if (tool.points === Infinity) page.hint(`${picks.length} picked. ${tool.hint}`);
  else page.hint(`${picks.length} of ${tool.points} picked.`);
  page.redraw();
}

async function finish() {
  const tool = page.tool();
  const { picks, region } = state;
  if (!region && picks.length < (tool.least ?? tool.points)) {
    page.hint(tool.hint, true);
    return;
  }
  const box = boxContent(clip.box);
  const around = { ...tools.circumstances(state), clip: boxText(clip.box) };
  const answer = tools.measured(state, tool, { picks, region, box });
  state.picks = [];
  state.region = null;
  page.hint("Measuring…");
  const before = page.hints;
  let words = [tool.hint];
  try {
    const found = await answer;
    const place = tools.placeOf(state.scene, picks, region);
    const spots = region ? [] : picks;
    page.keep({ kind: tool.kind, picks: spots, region, place, found, ...around });
  } catch (error) {
    words = [error.message, true];
  }
  // The user has since caused a newer message.
  if (before === page.hints) page.hint(...words);
  page.redraw();
}

/** Return a measurement as text, for the list. */
function said({ kind, channel, found }) {
  const { main: parts, rests } = tools.worded(found);
  const name = page.tool(kind).name;
  const words = [name, state.scene.channels.length > 1 && channel, ...parts.slice(1), rests];
  const figure = found.profile && !found.doubt && halfProfile(found.profile, page.colours);
  if (figure) figure.setAttribute("aria-label", `Half-profile: ${parts.join(", ")}`);
  if (figure) figure.setAttribute("role", "img");
  return { main: parts[0], doubt: found.doubt, words: words.filter(Boolean).join(" · "), figure };
}

/** Drags on the map other than panning: regions of fits and the line of a section. */
function dragged(phase, start, event, view) {
  const tool = page.tool();
  const line = state.profileKind === "section" && state.drawing;
  if (!(tool?.region || line)) return false;
  const [one, other] = [view.pixel(state.scene, start, true), view.pixel(state.scene, event, true)];
  spanned(one, other);
  if (line) {
    if (phase === "end") state.drawing = false;
    page.dragsOn("map", state.drawing);
  } else {
    if (phase === "end") {
      const [r0, c0, r1, c1] = /** @type {number[]} */ (state.region);
      if (r1 > r0 || c1 > c0) finish();
      else state.region = null;
    }
  }
  page.redraw();
  return true;
}

/** Span the line of a section or the rectangle of a fit between two pixels. */
function spanned(one, other) {
  if (state.profileKind === "section" && state.drawing) state.section = [one, other];
  else
    state.region = [
      Math.min(one[0], other[0]),
      Math.min(one[1], other[1]),
      Math.max(one[0], other[0]),
      Math.max(one[1], other[1]),
    ];
}

/** Set the first end of a line or rectangle by keyboard, or finish it at the second end. */
function cornered(pixel) {
  if (!state.corner) {
    state.corner = pixel;
    page.hint("First end set. Move with the arrow keys; Enter sets the other end.");
    return;
  }
  spanned(state.corner, pixel);
  state.corner = null;
  if (state.drawing) {
    state.drawing = false;
    page.dragsOn("map", false);
  } else finish();
}

function profileAlong(kind) {
  state.profileKind = kind;
  state.drawing = kind === "section";
  for (const button of $("profile-kind").children)
    button.setAttribute("aria-pressed", String(button.dataset.kind === kind));
  if ($("plots").hidden) stage.toggle();
  if (state.drawing) page.hint("Drag a line over the map, or set its ends with Enter.");
  page.dragsOn("map", state.drawing);
  page.redraw();
}

/** Picture of a view with title, color scale and description. */
async function picture(view) {
  const { scene } = state;
  const layer = scene.byName.get(state.layerName);
  const flags = layer.kind === "flags";
  const bar = flags ? null : page.bar(layer, unitOf(layer));
  const words = [
    $("subtitle").textContent,
    `Channel ${scene.channel}, ${state.raw || scene.water_in ? "water in" : "water removed"}.`,
  ];
  if (view.id === "cloud" && !views.cloud.camera.orthographic)
    words.push("In perspective: no scale.");
  if (flags) words.push([...$("legend").children].map((one) => one.textContent).join("; "));
  else if (($("light").checked && layer.kind === "range") || state.look.contour)
    words.push($("light-note").textContent);
  words.push(...state.measurements.map(tools.captioned));
  draw();
  await page.picture(view, view.id === "cloud" ? "view" : layer.name, words, bar);
}

/** Return the content of the printed sheet; null before the maps are loaded. */
function sheet() {
  const { scene } = state;
  if (!scene?.maps.has(state.layerName)) return null;
  light();
  const layer = scene.byName.get(state.layerName);
  const flags = layer.kind === "flags";
  const at = `Axes and scale bar are valid at ${withUnit(scene.typical, "m", 3)}.`;
  const names = {
    map: `Map: ${layer.label.toLowerCase()}. ${at}`,
    cloud: views.cloud.camera.orthographic ? "In space." : "In space, in perspective: no scale.",
  };
  const look = { ...state.look };
  const drawn = (name) => (colours) => {
    Object.assign(state.look, { ground: colours.ground, missing: colours.missing });
    views[name].draw(state, colours);
    Object.assign(state.look, look);
  };
  return {
    title: scene.title,
    words: [$("subtitle").textContent, ...tools.provenance(state)],
    pictures: ["map", "cloud"]
      .filter((name) => stage.shows(name))
      .map((name) => ({
        canvas: views[name].canvas,
        name: names[name],
        high: (width) => views[name].high(scene, width),
        draw: drawn(name),
      })),
    shape: { across: scene.wide, down: scene.high * scene.aspect },
    bar: flags ? null : page.bar(layer, unitOf(layer)),
    rows: state.measurements.map(tools.tabled),
    notes: [
      ...state.annotations.map(
        ({ name, text, row, column }) => `${name} (row ${row}, column ${column}): ${text}`,
      ),
      ...scene.notes,
      ...(flags ? [[...$("legend").children].map((one) => one.textContent).join("; ")] : []),
      ...(clip.box ? [`Clip box: ${boxText(clip.box)}.`] : []),
      ...($("light").checked || state.look.contour ? [$("light-note").textContent] : []),
    ],
  };
}

function csv() {
  const { scene } = state;
  const { profileKind: kind, cursor, section } = state;
  const pixels = along(scene, { kind, cursor, section });
  const layer = scene.byName.get(state.profileLayer);
  const lines = [["row", "column", "along_m", `${layer.name}_${layer.unit}`, "uncertainty_m"]];
  for (const { pixel, x, value, error } of profileOf(scene, pixels, layer.name)) {
    lines.push([...pixel, x, value, error]);
  }
  const text = lines.map((line) => `${line.join(",")}\n`).join("");
  download(`${page.stem()}-profile.csv`, new Blob([text], { type: "text/csv" }));
}

function narrow() {
  const { scene, cursor } = state;
  const layer = scene.byName.get(state.layerName);
  const value = cursor && scene.value(state.layerName, ...cursor);
  if (!Number.isFinite(value) || layer.kind === "flags") return;
  const span = Math.max((state.limits[1] - state.limits[0]) / 4, scene.least(state.layerName));
  const middle = layer.kind === "signed" ? 0 : value;
  page.limit(state.layerName, [middle - span, middle + span]);
}

function automatic() {
  page.limit(state.layerName);
}

function limited() {
  state.limits = limitsOf(state.layerName);
}

async function water(raw) {
  const { scene } = state;
  if (!(scene.byName.has("range") && scene.byName.has("range_before"))) return;
  state.raw = raw;
  await Promise.all(
    ["range_before", "flags_before"]
      .filter((name) => scene.byName.has(name))
      .map((name) => scene.load(name)),
  );
  await show(state.layerName.replace("_before", ""));
  views.cloud.follow(scene, shownRaw() ? "range_before" : scene.main);
}

const KEYS = {
  w: () => water(!state.raw),
  r: () => {
    views.map.home();
    views.cloud.home(state.scene, shownRaw() ? "range_before" : state.scene.main);
  },
  o: () => page.orthographic(views.cloud.camera),
  v: pointsOrSurface,
  b: clipping,
  c: () => notes.saveView(),
  t: () => notes.annotate(),
  f: () => views.cloud.front(),
  d: () => page.otherTheme(),
  s: () => page.save(),
  l: () => profileAlong("section"),
  m: () => stage.next(),
  g: () => stage.toggle(),
  a: automatic,
  n: narrow,
  x: () => state.products?.open(),
  p: () => picture($("map")).catch(failed),
  "?": () => $("keys").showModal(),
  "+": () => zoomed(0.8),
  "-": () => zoomed(1.25),
  Escape: () => page.choose(null),
  Enter: entered,
};

/** Open or close the clip box. */
function clipping() {
  stage.need("cloud");
  clip.toggle(views.cloud.spread(state.scene));
}

/** Switch between the surface through the pixels and points only. */
function pointsOrSurface() {
  views.cloud.points = !views.cloud.points;
  $("points").setAttribute("aria-pressed", String(views.cloud.points));
}

/** Finish a measurement that has enough points, or else pick the pixel under the pointer. */
function entered() {
  const tool = page.tool();
  const least = tool?.least;
  if (state.cursor && (state.drawing || tool?.region)) cornered(state.cursor);
  else if (least && state.picks.length >= least) finish();
  else if (state.cursor) picked(state.cursor);
}

function zoomed(factor) {
  if (document.activeElement === $("cloud")) views.cloud.camera.zoom(factor);
  else views.map.zoom = Math.min(Math.max(views.map.zoom / factor, 1), 200);
}

function arrow(into, [dx, dy], { shiftKey }) {
  if (into === $("cloud")) {
    views.cloud.camera.orbit(dx * 0.08, dy * 0.08);
    page.redraw();
    return true;
  }
  if (into !== $("map")) return false;
  const { scene } = state;
  const step = scene.stride * (shiftKey ? 10 : 1);
  const [row, column] = state.cursor ?? [0, 0];
  const within = (value, count) => Math.min(Math.max(value, 0), count - 1);
  /** @type {Pixel} */
  const to = [within(row + dy * step, scene.rows), within(column + dx * step, scene.columns)];
  state.pinned = to;
  if (state.corner) {
    spanned(state.corner, to);
    page.redraw();
  }
  point(to);
  return true;
}

function numbered(at) {
  const name = state.tabs?.[at];
  if (name) show(name).catch(failed);
  return Boolean(name);
}

function wired() {
  page.wire({
    clicks: {
      save: KEYS.s,
      products: KEYS.x,
      "map-picture": KEYS.p,
      "cloud-picture": () => picture($("cloud")).catch(failed),
      theme: KEYS.d,
      help: KEYS["?"],
      auto: automatic,
      narrow,
      ortho: KEYS.o,
      points: KEYS.v,
      clip: KEYS.b,
      front: KEYS.f,
      home: KEYS.r,
      "profile-csv": csv,
    },
    keys: KEYS,
    arrow,
    numbered,
    texts: {
      text: () => tools.asText(state),
      rows: () => tools.asRows(state),
      content: () => tools.asObject(state),
    },
  });
  for (const button of $("water").querySelectorAll("button"))
    button.addEventListener("click", () => water(button.dataset.raw === "yes").catch(failed));
  for (const button of $("profile-kind").children)
    button.addEventListener("click", () => profileAlong(button.dataset.kind));
  fields();
  new ResizeObserver(() => {
    stage.arrange();
    resized();
  }).observe(/** @type {Element} */ (document.querySelector("main")));
}

function fields() {
  for (const id of ["light", "light-turn", "light-rise", "contour", "averaged"])
    $(id).addEventListener("input", () => page.redraw());
  $("reach").addEventListener("input", () => {
    for (const name of [state.scene.main, "range_before"])
      state.scene.smooth(name, Number($("reach").value));
    lightNote();
    page.redraw();
  });
  $("average").addEventListener("input", (event) => {
    state.average = Number(event.target.value);
  });
  $("channel").addEventListener("input", (event) =>
    opened(event.target.value)
      .then(() => point(state.cursor))
      .catch(failed),
  );
}

let later = 0;
function thumbnailsLater() {
  clearTimeout(later);
  later = setTimeout(() => state.scene?.maps.size && (thumbnails(), page.redraw()), 150);
}

let reloading = Promise.resolve();

/** Functions of the page that the live view calls. */
const forLive = {
  state,
  plots: () => stage.shows("plots"),
  say,
  unsay,
  colours: () => page.colours,
  /** Load all maps again after a recomputation. */
  async reload() {
    const before = state.scene.limits(state.scene.main);
    const nothing = before[0] === 0 && before[1] === 1;
    if (nothing) views.placed = state.calmed = false;
    // Loads run one after the other; two at once would mix their maps.
    reloading = reloading
      .catch(() => {})
      .then(async () => {
        await opened(state.scene.channel);
        await point(state.cursor);
        // The title of the tab states the progress.
        state.live?.draw();
      });
    return reloading;
  },
  /** Move the cursor to the newest row of a running scan, unless the user has moved it. */
  follow(row) {
    const { cursor, pinned, scene } = state;
    const to = row - (row % scene.stride);
    if (state.follow && !pinned && cursor && cursor[0] !== to) point([to, cursor[1]]);
  },
  /** Draw new rows, with color limits that include them. */
  refresh() {
    state.limits = limitsOf(state.layerName);
    readout();
    page.redraw();
  },
};

async function main() {
  state.renderer = new Renderer();
  state.renderer.lost = () => say("The GPU was lost; reload the page.");
  page.theme();
  const hover = (pixel) => {
    // A moved cursor stays where it is; a double click makes it follow the scan again.
    if (pixel !== undefined) state.follow = pixel === null;
    return point(pixel);
  };
  views.map = new MapView($("map"), { hover, pick: picked, drag: dragged });
  views.cloud = new CloudView($("cloud"), {
    clip,
    hover: (pixel) => pixel && hover(pixel),
    pick: picked,
    changed: () => {
      turned = true;
      page.repoint();
    },
  });
  state.views = views;
  printable(sheet, () => page.redraw());
  wired();
  await opened();
  state.record.open(state.scene.name);
  await notes.open(state.scene.name).catch(failed);
  if (state.scene.live) state.live = new Live($("scan-card"), forLive);
  const products = new Products($("order"), {
    source: state.source,
    channel: () => state.scene.channel,
    section: () => (state.profileKind === "section" ? state.section : null),
  });
  if (await products.offered()) {
    state.products = products;
    $("products").hidden = false;
  }
  document.documentElement.dataset.complete = "yes";
  state.digest = await state.source.digest().catch(() => "");
}

// Inside a report only map and points are shown; measuring works in the map.
if (window.self !== window.top) document.documentElement.dataset.embedded = "yes";
Object.assign(window, { amulor: state });
main().catch(failed);
