// Track and coverage of a running scan from a vehicle.

import { INK } from "./colour.js";
import { $, made } from "./dom.js";
import { scaleBar } from "./marks.js";
import { empty, started } from "./plots.js";

/** Part of the wanted density above which a line is dense, and above which it is sparse [1]. */
const DENSE = 0.8;
const SPARSE = 0.5;
/** Margin around the picture [pixel]. */
const MARGIN = 14;

/** @typedef {[number, number]} Place */

/**
 * Density of a line as a word: its color, and its part in the key.
 * @param {number | null} share
 */
export function densityOf(share) {
  if (share === null) return "unknown";
  if (share >= DENSE) return "as wanted";
  return share >= SPARSE ? "sparse" : "too sparse";
}

/**
 * Return the function from places [m] to pixels that fits all places into a box.
 * @param {Place[]} places
 * @param {{width: number, height: number}} size
 */
export function fitting(places, { width, height }) {
  const [xs, ys] = [places.map(([x]) => x), places.map(([, y]) => y)];
  const [left, right] = [Math.min(...xs), Math.max(...xs)];
  const [low, high] = [Math.min(...ys), Math.max(...ys)];
  const scale = Math.min(
    (width - 2 * MARGIN) / Math.max(right - left, 1e-3),
    (height - 2 * MARGIN) / Math.max(high - low, 1e-3),
  );
  const middle = [(left + right) / 2, (low + high) / 2];
  /** @type {(place: Place) => Place} */
  const at = ([x, y]) => [
    width / 2 + (x - middle[0]) * scale,
    height / 2 - (y - middle[1]) * scale,
  ];
  return { at, scale };
}

/** Numbers beside the picture: name, value and whether it is a warning. */
export function numbersOf(state) {
  const rows = [];
  const add = (name, text, wrong = false) => rows.push({ name, text, wrong });
  if (state.speed !== null)
    add("speed", `${plain(state.speed)} m/s, ${plain(state.planned_speed)} planned`);
  if (state.between !== null) {
    const text = `${plain(1e3 * state.between)} mm, ${plain(1e3 * state.wanted)} wanted`;
    add("between lines", text, state.between > 1.2 * state.wanted);
  }
  if (state.density !== null && state.wanted_density !== null) {
    const [found, wanted] = [state.density, state.wanted_density].map(grouped);
    const word = densityOf(state.density / state.wanted_density);
    add("points per m²", `${found}, ${wanted} wanted`, word !== "as wanted");
  }
  if (state.area) add("covered", `${plain(state.area)} m²`);
  add("lines", String(state.lines));
  if (state.without_pose) add("without a pose", `${grouped(state.without_pose)} pixels`, true);
  return rows;
}

/** Return a number to three digits at most, as the advice states it. */
function plain(value) {
  return String(Number(value.toPrecision(3)));
}

/** Return a number to three digits, with commas between thousands. */
function grouped(value) {
  return Number(value.toPrecision(3)).toLocaleString("en");
}

/** Card with the picture of the track, requested again as the scan goes on. */
export class Vehicle {
  #page;
  #card;
  #list = document.createElement("dl");
  #canvas = made("canvas", { id: "vehicle-plan" });
  #key = made("div", { className: "legend" });
  #remarks = made("ul", { className: "remarks" });
  /** @type {any} */
  #found = null;
  #asked = 0;

  constructor(page) {
    this.#page = page;
    this.#card = $("vehicle-card");
    this.#canvas.setAttribute("role", "img");
    const head = made("div", { className: "bar" }, made("h2", {}, "Vehicle"));
    const stage = made("div", { className: "stage" }, this.#canvas);
    this.#card.append(head, this.#list, stage, this.#key, this.#remarks);
  }

  /** Request track and coverage if the server has computed them again. */
  async update(version) {
    if (version === this.#asked) return;
    this.#asked = version;
    try {
      this.#found = await this.#page.state.source.coverage();
      this.draw();
    } catch {
      // The scan card reports a lost server.
      this.#asked = 0;
    }
  }

  draw() {
    const state = this.#found;
    if (!state?.remarks) return;
    this.#card.hidden = false;
    this.#list.replaceChildren(
      ...numbersOf(state).flatMap(({ name, text, wrong }) => [
        made("dt", {}, name),
        made("dd", { className: wrong ? "wrong" : "" }, text),
      ]),
    );
    this.#remarks.replaceChildren(...state.remarks.map((text) => made("li", {}, text)));
    this.#picture(state);
    document.documentElement.dataset.lines = String(state.lines);
  }

  #picture(state) {
    const view = started(this.#canvas);
    const colours = this.#page.colours();
    const known = (places) => places.filter((place) => place !== null);
    const lines = state.footprint.map(known);
    const track = known(state.track);
    const all = [...lines.flat(), ...track];
    if (!all.length) {
      empty(view, "No pose is known yet.", colours);
      return;
    }
    const inks = {
      "as wanted": colours.accent,
      sparse: INK.orange,
      "too sparse": INK.vermilion,
      unknown: INK.grey,
    };
    const { at, scale } = fitting(all, view);
    const { ctx } = view;
    lines.forEach((line, k) =>
      stroke(ctx, line.map(at), inks[densityOf(state.share[k])], { width: 1.2 }),
    );
    stroke(ctx, known(state.course).map(at), colours.soft, { dashes: [4, 4] });
    stroke(ctx, track.map(at), colours.ink, { width: 2 });
    const [x, y] = at(track.at(-1) ?? all[0]);
    ctx.fillStyle = colours.ink;
    ctx.beginPath();
    ctx.arc(x, y, 4, 0, 7);
    ctx.fill();
    const { width, height } = view;
    const box = { right: width, bottom: height, most: width / 3 };
    scaleBar(ctx, scale, 1, colours, "", box);
    const used = new Set(state.share.map(densityOf));
    this.#key.replaceChildren(
      ...Object.entries(inks)
        .filter(([word]) => used.has(word))
        .map(([word, ink]) => {
          const mark = made("i");
          mark.style.background = ink;
          return made("span", {}, mark, word);
        }),
      made("span", {}, "solid: track; dashed: planned"),
      made("span", {}, state.plan ? "plan, north up" : "seen along the beams"),
    );
    const words = numbersOf(state).map(({ name, text }) => `${name} ${text}`);
    this.#canvas.setAttribute("aria-label", `Track and lines of points; ${words.join("; ")}`);
  }
}

function stroke(ctx, places, ink, { width = 1, dashes = /** @type {number[]} */ ([]) } = {}) {
  ctx.strokeStyle = ink;
  ctx.lineWidth = width;
  ctx.setLineDash(dashes);
  ctx.beginPath();
  places.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
  ctx.stroke();
  ctx.setLineDash([]);
}
