// Page of an instrument design: sliders, and the map of predicted errors.

import { table } from "./colour.js";
import { $, inkOf, made, ratioOf } from "./dom.js";
import { ErrorMap, hatch, LIMITS, placeIn } from "./error_map.js";
import { fitted } from "./map.js";
import { failed, say } from "./panel.js";
import { download } from "./picture.js";
import { short } from "./text.js";
import { firstTheme, nextTheme, themed } from "./theme.js";

/** Number of steps of a slider. */
const STEPS = 200;

const state = {
  // Answers of the server on the design and on the latest map.
  scene: /** @type {any} */ (null),
  found: /** @type {any} */ (null),
  settings: /** @type {Record<string, number>} */ ({}),
  water: "",
  mark: /** @type {[number, number] | null} */ (null),
  asked: 0,
  busy: false,
  wanted: false,
  timing: /** @type {Record<string, number>[]} */ ([]),
};
const shades = table("cividis");
let colours = {};
let map;

async function ask(path, body) {
  const request =
    body === undefined
      ? {}
      : {
          method: "POST",
          headers: { "content-type": "application/json" },
          body: JSON.stringify(body),
        };
  const answer = await fetch(path, request);
  if (!answer.ok)
    throw new Error(
      (await answer.json().catch(() => ({}))).error ?? `The server answered ${answer.status}.`,
    );
  return answer;
}

function valueAt(slider, step) {
  const share = step / STEPS;
  return slider.scale === "log"
    ? slider.low * (slider.high / slider.low) ** share
    : slider.low + share * (slider.high - slider.low);
}

function stepOf(slider, value) {
  const share =
    slider.scale === "log"
      ? Math.log(value / slider.low) / Math.log(slider.high / slider.low)
      : (value - slider.low) / (slider.high - slider.low);
  return Math.round(STEPS * share);
}

function shown(slider, value) {
  return `${short(value * slider.factor, 3)} ${slider.unit}`.trim();
}

function controls() {
  const { scene } = state;
  const water = made("label", { textContent: "water" });
  const choice = made("select", { id: "water" });
  choice.append(
    ...scene.waters.map((one) => made("option", { value: one.name, textContent: one.label })),
  );
  choice.addEventListener("change", () => {
    state.water = choice.value;
    update();
  });
  water.append(choice);
  const rows = scene.sliders.map((slider) => {
    const row = made("label", {});
    const input = made("input", {
      type: "range",
      min: 0,
      max: STEPS,
      step: 1,
      id: `slider-${slider.name}`,
    });
    input.setAttribute("aria-label", slider.label);
    const said = made("output", { htmlFor: input.id });
    input.addEventListener("input", () => {
      state.settings[slider.name] = valueAt(slider, Number(input.value));
      told(slider, input, said);
      update();
    });
    row.append(made("span", { textContent: slider.label }), said, input);
    return row;
  });
  $("sliders").replaceChildren(...rows, water);
}

function told(slider, input, said) {
  const text = shown(slider, state.settings[slider.name]);
  said.textContent = text;
  input.setAttribute("aria-valuetext", text);
}

function reset() {
  const { scene } = state;
  state.settings = Object.fromEntries(scene.sliders.map((slider) => [slider.name, slider.value]));
  state.water = scene.water;
  $("water").value = scene.water;
  for (const slider of scene.sliders) {
    const input = $(`slider-${slider.name}`);
    input.value = stepOf(slider, slider.value);
    told(slider, input, input.previousElementSibling);
  }
  return update();
}

/** Request the map for the slider settings; during a request, the latest one waits. */
async function update() {
  state.wanted = true;
  if (state.busy) return;
  state.busy = true;
  try {
    while (state.wanted) {
      state.wanted = false;
      const begun = performance.now();
      const answer = await ask("map", { settings: state.settings, water: state.water });
      state.found = await answer.json();
      const received = performance.now();
      say("");
      draw();
      const drawn = performance.now();
      state.timing.push({
        server: state.found.milliseconds,
        answer: received - begun,
        draw: drawn - received,
        total: drawn - begun,
      });
      $("timing").textContent = `${Math.round(drawn - begun)} ms`;
      // The map has priority; the verdict is requested when the slider rests.
      if (!state.wanted)
        goals(await (await ask("met", { settings: state.settings, water: state.water })).json());
    }
  } catch (error) {
    say(error.message ?? String(error));
  } finally {
    state.busy = false;
  }
}

function draw() {
  if (!state.found) return;
  fitted($("map"));
  map.draw({ scene: state.scene, found: state.found, colours, table: shades });
  bar();
  point();
}

/** Draw the marker on the map, and display the errors there. */
function point() {
  if (!state.found) return;
  map.point({ scene: state.scene, mark: state.mark, colours });
  readout();
}

function bar() {
  const canvas = $("bar");
  fitted(canvas);
  const ratio = ratioOf(canvas);
  const ink = inkOf(canvas);
  ink.clearRect(0, 0, canvas.width, canvas.height);
  const high = 13 * ratio;
  for (let x = 0; x < canvas.width; x += 1) {
    const from = 4 * Math.round((255 * x) / canvas.width);
    ink.fillStyle = `rgb(${shades[from]}, ${shades[from + 1]}, ${shades[from + 2]})`;
    ink.fillRect(x, 0, 1, high);
  }
  ink.fillStyle = colours.ink;
  ink.font = `${12 * ratio}px ${colours.font}`;
  ink.textBaseline = "top";
  const [low, top] = LIMITS.map(Math.log);
  for (const value of [0.1, 0.3, 1, 3, 10, 30, 100]) {
    const share = (Math.log(value) - low) / (top - low);
    ink.textAlign = share < 0.01 ? "left" : share > 0.99 ? "right" : "center";
    ink.fillText(String(value), share * canvas.width, high + 4 * ratio);
  }
}

function legend() {
  const items = state.scene.regions.map((region, number) => {
    const item = made("span", {});
    const swatch = made("canvas", { width: 44, height: 26 });
    const ink = inkOf(swatch);
    ink.fillStyle = "#7c7b78";
    ink.fillRect(0, 0, 44, 26);
    ink.fillStyle = hatch(ink, number, 1.4);
    ink.fillRect(0, 0, 44, 26);
    item.append(swatch, region.label);
    return item;
  });
  if (state.scene.asked.length) items.unshift(made("span", { textContent: "○ asked for" }));
  $("legend").replaceChildren(...items);
}

function goals(places) {
  $("said").replaceChildren(
    ...places.map((one) =>
      made("li", { textContent: one.text, className: one.met ? "" : "missed" }),
    ),
  );
}

function readout() {
  const { scene, found, mark } = state;
  if (!mark) {
    $("readout").replaceChildren(
      made("dd", {
        className: "words",
        textContent: "Point at the map, or move a mark with the arrow keys.",
      }),
    );
    return;
  }
  const at = mark[1] * scene.distance.length + mark[0];
  const flags = scene.regions
    .filter((region) => found.flags[at] & region.bit)
    .map((region) => region.label);
  const error = found.error[at];
  const rows = [
    ["distance", `${short(scene.distance[mark[0]], 3)} m`],
    ["attenuation", `${short(scene.attenuation[mark[1]], 3)} 1/m`],
    ["total error", error === null ? "none" : `${short(error, 3)} mm`],
    ["binds", scene.terms[found.term[at]] ?? "–"],
  ];
  if (flags.length) rows.push(["", flags.join(", ")]);
  $("readout").replaceChildren(
    ...rows.flatMap(([name, text]) => [
      made("dt", { textContent: name }),
      made("dd", { textContent: text }),
    ]),
  );
}

function moveMark(column, row) {
  const { scene } = state;
  const start = state.mark ?? [
    Math.floor(scene.distance.length / 2),
    Math.floor(scene.attenuation.length / 2),
  ];
  const kept = (value, count) => Math.min(Math.max(value, 0), count - 1);
  state.mark = [
    kept(start[0] + column, scene.distance.length),
    kept(start[1] + row, scene.attenuation.length),
  ];
  point();
}

async function save() {
  try {
    const answer = await ask("survey", { settings: state.settings, water: state.water });
    download("survey.toml", await answer.blob());
  } catch (error) {
    say(error.message ?? String(error));
  }
}

function toggle() {
  colours = nextTheme();
  draw();
}

function wired() {
  map = new ErrorMap($("map"));
  const pointed = (event) => {
    const place = map.place(event, state.scene);
    if (!place) return;
    state.mark = place;
    point();
  };
  $("map").addEventListener("pointermove", pointed);
  $("map").addEventListener("pointerdown", pointed);
  $("map").addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[
      event.key
    ];
    if (!step) return;
    moveMark(...step);
    event.preventDefault();
  });
  $("reset").addEventListener("click", reset);
  $("save").addEventListener("click", save);
  $("theme").addEventListener("click", toggle);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target instanceof HTMLSelectElement) return;
    const act = { r: reset, s: save, d: toggle }[event.key.toLowerCase()];
    if (act) act();
  });
  new ResizeObserver(draw).observe($("map"));
}

async function main() {
  colours = themed(firstTheme());
  state.scene = await (await ask("scene")).json();
  const { scene } = state;
  document.title = `${scene.title} · amulor design`;
  $("title").textContent = scene.title;
  $("subtitle").textContent = scene.subtitle;
  if (scene.asked.length) {
    const near = (values, value) =>
      Math.min(Math.max(Math.round(placeIn(values, value)), 0), values.length - 1);
    state.mark = [
      near(scene.distance, scene.asked[0][0]),
      near(scene.attenuation, scene.asked[0][1]),
    ];
  }
  wired();
  controls();
  await document.fonts.load("14px Inter");
  legend();
  await reset();
  document.documentElement.dataset.complete = "yes";
}

Object.assign(window, { amulor: state });
main().catch(failed);
