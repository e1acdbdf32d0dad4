// Signals of a running scan over time: amplitude, phase, noise and mean output.

import { INK } from "./colour.js";
import { $, made } from "./dom.js";
import { empty, framed, started } from "./plots.js";
import { scaled, short, withError, withUnit } from "./text.js";

/** Shortest time between two requests [ms]. */
const PAUSE = 1000;

/** Quantities; those of the light leave out samples without light. */
const STRIPS = [
  { name: "amplitude", label: "amplitude", unit: "V", lit: true },
  { name: "phase", label: "phase", unit: "rad", lit: true },
  { name: "noise", label: "noise", unit: "V", lit: false },
  { name: "mean", label: "mean output", unit: "V", lit: false },
];
const DARK = ["dark", "shutter"];

/** Colors of the kinds of samples. */
const colourOf = (kind, colours) =>
  kind === "scan" ? colours.accent : DARK.includes(kind) ? INK.grey : INK.vermilion;

/** Plots of the drawer, requested again as the scan goes on. */
export class Traces {
  /** Time of a replay, drawn as a line [s]. @type {number | null} */
  until = null;
  /** @type {any} */
  #found = null;
  #asked = "";
  #done = 0;
  #timer = 0;
  #page;
  #canvases;

  constructor(page) {
    this.#page = page;
    $("traces").hidden = false;
    this.#canvases = STRIPS.map(({ name }) => made("canvas", { id: `strips-${name}` }));
    for (const canvas of this.#canvases) canvas.setAttribute("role", "img");
    $("strips").replaceChildren(
      ...this.#canvases.map((canvas) => made("div", { className: "stage" }, canvas)),
    );
    $("traces-frequency").addEventListener("change", () => this.#ask());
  }

  /** Request the samples again if there are new ones. */
  update(done) {
    this.#done = done;
    if (!this.#timer && this.#wanted() !== this.#asked) this.#ask();
  }

  #wanted() {
    const { channel } = this.#page.state.scene;
    return [channel, $("traces-frequency").value || "0", this.#done].join(" ");
  }

  async #ask() {
    if (!this.#page.plots()) return;
    this.#asked = this.#wanted();
    clearTimeout(this.#timer);
    this.#timer = window.setTimeout(() => {
      this.#timer = 0;
      this.update(this.#done);
    }, PAUSE);
    const { scene, source } = this.#page.state;
    try {
      this.#found = await source.traces(scene.channel, Number($("traces-frequency").value) || 0);
      this.draw();
    } catch {
      // The scan card reports a lost server.
      this.#asked = "";
    }
  }

  draw() {
    const found = this.#found;
    if (!found) return;
    this.#named(found);
    const colours = this.#page.colours();
    STRIPS.forEach((strip, at) => drawStrip(this.#canvases[at], strip, found, colours, this.until));
    document.documentElement.dataset.traced = String(found.samples);
  }

  /** Update the list of frequencies and the key of the colors. */
  #named({ frequencies, samples, kind }) {
    const list = $("traces-frequency");
    if (list.length !== frequencies.length)
      list.replaceChildren(
        ...frequencies.map((value, at) => new Option(`${short(value / 1e6, 4)} MHz`, String(at))),
      );
    const colours = this.#page.colours();
    const kinds = [...new Set(kind)].map((one) => {
      const mark = made("i");
      mark.style.background = colourOf(one, colours);
      return made("span", {}, mark, one.replace("_", " "));
    });
    const every = Math.round(samples / Math.max(kind.length, 1));
    const thinned = every > 1 ? [made("span", {}, `one of ${every} samples`)] : [];
    $("traces-note").replaceChildren(...thinned, ...kinds);
  }
}

/** Draw one quantity over time; the newest value is stated above. */
function drawStrip(canvas, { name, label, unit, lit }, found, colours, until) {
  const view = started(canvas);
  const shown = found.kind
    .map((kind, at) => ({ kind, x: found.elapsed[at], y: found[name][at], at }))
    .filter(({ kind, x, y }) => x !== null && y !== null && !(lit && DARK.includes(kind)));
  const last = shown.at(-1);
  if (!last) {
    canvas.setAttribute("aria-label", `${label}: not recorded`);
    return empty(view, `No ${label} is recorded.`, colours);
  }
  const [xs, ys] = [shown.map(({ x }) => x), shown.map(({ y }) => y)];
  const [low, high] = [Math.min(...ys), Math.max(...ys)];
  const scale = scaled(Math.max(Math.abs(low), Math.abs(high)), unit);
  const room = (high - low) * 0.06 || Math.abs(high) * 0.01 || 1 / scale.factor;
  const time = Math.max(...xs) > 600 ? { unit: "min", factor: 1 / 60 } : { unit: "s", factor: 1 };
  const { toX, toY, box } = framed(
    view,
    { low: 0, high: (Math.max(...xs) || 1) * time.factor, label: `scan time [${time.unit}]` },
    {
      low: (low - room) * scale.factor,
      high: (high + room) * scale.factor,
      label: `[${scale.unit}]`,
    },
    colours,
    20,
  );
  const { ctx } = view;
  for (const { kind, x, y } of shown) {
    ctx.fillStyle = colourOf(kind, colours);
    ctx.fillRect(toX(x * time.factor) - 1, toY(y * scale.factor) - 1, 2, 2);
  }
  if (until !== null) {
    ctx.fillStyle = colours.ink;
    ctx.fillRect(toX(until * time.factor), box.top - 4, 1, box.bottom - box.top + 4);
  }
  const error = {
    amplitude: found.noise[last.at],
    phase: found.noise[last.at] / found.amplitude[last.at],
  };
  const value = name in error ? withError(last.y, error[name], unit) : withUnit(last.y, unit, 3);
  const text = `${label} ${value}`;
  canvas.setAttribute("aria-label", `Over time, the last value of ${text}`);
  ctx.fillStyle = colours.ink;
  ctx.textAlign = "right";
  ctx.textBaseline = "top";
  ctx.fillText(text, box.right, 0);
}
