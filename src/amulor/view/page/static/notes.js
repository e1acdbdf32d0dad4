// Saved views and annotations, kept beside the data by the server or in the browser.

import { $, made } from "./dom.js";

/**
 * Text at a pixel of a scan, or at a place of a cloud [m].
 * @typedef {{name: string, text: string, channel?: string, row?: number, column?: number, place?: number[]}} Annotation
 */
/** @typedef {{revision: number, annotations: Annotation[], views: any[], file: string | null}} Content */

/** Letters of a name and of a text. */
const LONGEST = { name: 60, text: 2000 };

/**
 * Return the notes of a page: those in its browser if they are newer, or else its own.
 * @param {Content} own
 * @param {string | null} stored
 * @returns {Content}
 */
export function newest(own, stored) {
  try {
    const kept = JSON.parse(stored ?? "null");
    const good = kept && Array.isArray(kept.annotations) && Array.isArray(kept.views);
    return good && kept.revision > own.revision ? { ...own, ...kept, file: own.file } : own;
  } catch {
    return own;
  }
}

/** Notes of a page: a list with names and texts, and where it is kept. */
export class Notes {
  /** @type {Content} */
  content = { revision: 0, annotations: [], views: [], file: null };
  #key = "";
  #source;
  #on;
  #writing = Promise.resolve();

  /** `on.view` returns the present view, `on.show` shows one, `on.go` marks the place of an annotation. */
  constructor(source, on) {
    this.#source = source;
    this.#on = on;
    $("view-save").addEventListener("click", () => this.saveView());
    $("annotate").addEventListener("click", () => this.annotate());
  }

  /** Load the notes on a file. */
  async open(name) {
    this.#key = ["amulor notes", location.pathname, name].join(" ");
    const own = await this.#source.notes();
    let stored = /** @type {string | null} */ (null);
    try {
      stored = own.file ? null : localStorage.getItem(this.#key);
    } catch {
      // Pages in frames of reports may have no storage.
    }
    this.content = newest(own, stored);
    this.#list();
  }

  saveView() {
    const { views } = this.content;
    const view = { name: `view ${views.length + 1}`, ...this.#on.view() };
    this.#change({ views: [...views, view] });
    this.#focus(".view .name");
  }

  /** Write a text at the marked place. */
  annotate() {
    const at = this.#on.place();
    if (!at) return;
    const { annotations } = this.content;
    const note = { name: `note ${annotations.length + 1}`, text: "", ...at };
    this.#change({ annotations: [...annotations, note] });
    this.#focus(".annotation .name");
  }

  /** Select the last of some fields. */
  #focus(place) {
    const field = [...$("book").querySelectorAll(place)].at(-1);
    field?.focus();
    field?.select();
  }

  #change(part) {
    this.content = { ...this.content, ...part };
    this.#list();
    this.#on.changed();
    this.#writing = this.#writing.then(() => this.#write());
  }

  async #write() {
    const { file, ...content } = this.content;
    try {
      if (file) {
        // Meanwhile, the user may have changed the content again.
        const { revision } = await this.#source.keepNotes(content);
        this.content.revision = revision;
      } else {
        this.content.revision += 1;
        localStorage.setItem(this.#key, JSON.stringify(this.content));
      }
      this.#where();
    } catch (error) {
      $("book-note").textContent = `Not kept: ${error.message}`;
    }
  }

  #where() {
    const { file, annotations, views } = this.content;
    const some = annotations.length + views.length > 0;
    const place = file ? `in ${file} beside the data` : "in this browser";
    $("book-note").textContent = some ? `Kept ${place}.` : "";
  }

  #list() {
    const { annotations, views } = this.content;
    $("book").replaceChildren(
      ...views.map((view) => this.#entry("views", view, () => this.#on.show(view))),
      ...annotations.map((note) => this.#entry("annotations", note, () => this.#on.go(note))),
    );
    this.#where();
  }

  #replaced(list, entry, next) {
    this.#change({ [list]: this.content[list].flatMap((one) => (one === entry ? next : [one])) });
  }

  #entry(list, entry, act) {
    const field = (tag, key, label) => {
      const input = made(tag, {
        className: key,
        value: entry[key],
        maxLength: LONGEST[key],
        ariaLabel: `${label} of ${entry.name}`,
      });
      input.addEventListener("change", () =>
        this.#replaced(list, entry, [{ ...entry, [key]: input.value.trim() }]),
      );
      return input;
    };
    const view = list === "views";
    const go = made("button", {
      type: "button",
      className: "mini",
      textContent: view ? "show" : "go",
      ariaLabel: `${view ? "Show" : "Go to"} ${entry.name}`,
    });
    go.addEventListener("click", act);
    const remove = made("button", {
      type: "button",
      className: "mini",
      textContent: "×",
      ariaLabel: `Remove ${entry.name}`,
    });
    remove.addEventListener("click", () => this.#replaced(list, entry, []));
    const parts = [go, field("input", "name", "Name"), remove];
    if (!view) parts.push(field("textarea", "text", "Text"));
    return made("li", { className: view ? "view" : "annotation" }, ...parts);
  }
}
