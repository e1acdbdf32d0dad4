// Common functions of the pages of scans and clouds: tools, hints, keys, colors, files.

import { flagColour, MAP_OF, table } from "./colour.js";
import { $, made } from "./dom.js";
import {
  addressLimits,
  LimitFields,
  limitsFrom,
  limitsKey,
  limitsOfAddress,
  limitsText,
} from "./limits.js";
import { colourBar } from "./map.js";
import { failed, listMeasurements } from "./panel.js";
import { download, pictureOf, png } from "./picture.js";
import { MeasurementRecord, wireRecord } from "./record.js";
import { firstTheme, nextTheme, themed } from "./theme.js";

const ARROWS = {
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  ArrowUp: [0, -1],
  ArrowDown: [0, 1],
};

/** A page with its state. Pages differ in `draw`, `point`, `limited`, `idle`, `said` and `tools`,
some also in `themed` and `needs`. */
export class Page {
  colours = {};
  /** Number of times that a hint was shown. */
  hints = 0;
  #on;
  #waiting = 0;
  #all = false;
  #limits = new LimitFields((limits) => this.limit(this.state.layerName, limits));

  constructor(state, on) {
    this.state = state;
    this.#on = on;
    state.ownLimits = limitsFrom(limitsOfAddress() ?? state.source.limits ?? "");
    for (const [kind, name] of Object.entries(MAP_OF)) state.tables[kind] = table(name);
    state.flagColour = flagColour;
    state.texts = (kept) => this.#on.said(kept).main;
    state.record = new MeasurementRecord(state, () => {
      this.#list();
      this.redraw();
    });
  }

  #list() {
    listMeasurements(this.state, this.#on.said, () => this.redraw());
  }

  /** Schedule one redraw of everything. */
  redraw() {
    this.#all = true;
    this.repoint();
  }

  /** Schedule one redraw of the overlays that follow the pointer. */
  repoint() {
    if (this.#waiting) return;
    this.#waiting = requestAnimationFrame(() => {
      this.#waiting = 0;
      const all = this.#all;
      this.#all = false;
      if (all) this.#on.draw();
      else this.#on.point();
    });
  }

  /** Apply the colors of the first theme. */
  theme() {
    this.#themed(themed(firstTheme()));
    // Drawings do not wait for the font of the page; they are drawn again with it.
    document.fonts.load("14px Inter").then(() => this.redraw());
  }

  otherTheme() {
    this.#themed(nextTheme());
  }

  #themed(colours) {
    this.colours = colours;
    this.#on.themed?.(colours);
    this.redraw();
  }

  hint(text, wrong = false) {
    this.hints += 1;
    $("hint").textContent = text;
    $("hint").classList.toggle("wrong", wrong);
  }

  /** Return the tool of a kind; by default the selected tool. */
  tool(kind = this.state.tool) {
    return this.#on.tools.find((tool) => tool.kind === kind);
  }

  /** Select a tool; deselect it if it is selected already. */
  choose(kind) {
    const { state } = this;
    state.tool = state.tool === kind ? null : kind;
    state.picks = [];
    state.region = null;
    state.corner = null;
    for (const button of $("tools").children) {
      button.setAttribute("aria-pressed", String(button.dataset.kind === state.tool));
    }
    this.hint(this.tool()?.hint ?? this.#on.idle);
    this.dragsOn("map", Boolean(this.tool()?.region));
    this.redraw();
  }

  /** Make touches draw on a view instead of scrolling the page. */
  dragsOn(id, draws) {
    if (draws) this.#on.needs?.(id);
    $(id)?.classList.toggle("draws", draws);
  }

  /** Add a measurement to the record. */
  keep(measurement) {
    const { state } = this;
    state.number += 1;
    const kept = { ...measurement, number: state.number };
    state.chosen = kept;
    state.record.change([...state.measurements, kept]);
  }

  /** Display title, the line below it, and notes. */
  titled({ title, notes }, subtitle) {
    document.title = `${title} · amulor`;
    $("title").textContent = title;
    $("subtitle").textContent = subtitle;
    $("notes-card").hidden = !notes.length;
    $("notes").replaceChildren(...notes.map((note) => made("li", { textContent: note })));
  }

  /** Return the label of a color scale, with its unit. */
  bar({ kind, label }, { unit, factor }) {
    const { tables, limits } = this.state;
    return { table: tables[kind], limits: limits.map((value) => value * factor), unit, label };
  }

  drawBar(layer, unit) {
    const bar = this.bar(layer, unit);
    colourBar($("bar"), bar.table, bar.limits, bar.unit, this.colours);
    this.#limits.show(layer, this.state.limits, unit);
  }

  /** Set the color limits of a map; without limits, they follow from the data.
   * @param {string} name
   * @param {number[] | null} limits
   */
  limit(name, limits = null) {
    const { ownLimits } = this.state;
    const key = limitsKey(name);
    if (limits) ownLimits.set(key, limits);
    else ownLimits.delete(key);
    addressLimits(ownLimits);
    this.#on.limited();
    this.redraw();
  }

  /** Switch between perspective and orthographic view. */
  orthographic(camera) {
    camera.orthographic = !camera.orthographic;
    $("ortho").setAttribute("aria-pressed", String(camera.orthographic));
  }

  stem() {
    return this.state.scene.name.replace(/\.\w+$/, "");
  }

  /** Save a view as a picture with title and description. */
  async picture(view, name, words, bar) {
    const { title } = this.state.scene;
    const canvas = pictureOf({ view, title, words, bar, colours: this.colours });
    download(`${this.stem()}-${name}.png`, await png(canvas));
  }

  /** Save the page as one file. */
  async save() {
    const { source, measurements, ownLimits } = this.state;
    try {
      if (source.saved) {
        this.hint("This page is a saved one; its measurements go with copy as text.", true);
      } else
        download(`${this.stem()}.html`, await source.page(measurements, limitsText(ownLimits)));
    } catch (error) {
      failed(error);
    }
  }

  /** Connect buttons, tools and keys. `clicks`: functions by button; `keys`: functions by key;
  `arrow` and `numbered` return whether they used a key; `texts`: the record as text. */
  wire({ clicks, keys, arrow, numbered, texts }) {
    for (const [id, act] of Object.entries(clicks)) {
      $(id).addEventListener("click", () => {
        act();
        this.redraw();
      });
    }
    const hint = (text) => this.hint(text);
    wireRecord(this.state, { download, hint, stem: () => this.stem(), ...texts });
    $("tools").replaceChildren(...this.#on.tools.map((tool) => this.#button(tool)));
    if (this.state.source.saved) $("save").hidden = true;
    this.hint(this.#on.idle);
    document.addEventListener("keydown", (event) => {
      if (!this.state.scene || elsewhere(event)) return;
      const step = ARROWS[event.key];
      if (step && arrow(event.target, step, event)) return event.preventDefault();
      if (pressing(event) || numbered(Number(event.key) - 1)) return undefined;
      const act = keys[event.key] ?? keys[event.key.toLowerCase()];
      if (!act) return undefined;
      // A field that the key opens does not get the letter.
      event.preventDefault();
      act();
      return this.redraw();
    });
  }

  #button(tool) {
    const { kind, name, hint } = tool;
    const button = made("button", { type: "button", textContent: name, title: hint });
    button.dataset.kind = kind;
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("click", () => this.choose(kind));
    return button;
  }
}

/** Return whether a key belongs to an input field, a dialog, or the browser. */
function elsewhere({ ctrlKey, metaKey, altKey, target }) {
  const fields = [HTMLInputElement, HTMLSelectElement, HTMLTextAreaElement];
  const field = fields.some((kind) => target instanceof kind);
  return ctrlKey || metaKey || altKey || field || document.querySelector("dialog[open]");
}

/** Return whether a key activates the focused button. */
function pressing({ key, target }) {
  return (key === "Enter" || key === " ") && target instanceof HTMLButtonElement;
}
