// Record of measurements: survives a reload, can be undone, and is written to files.

import { $ } from "./dom.js";

/** Measurements of a page; every change can be undone. */
export class MeasurementRecord {
  #state;
  #changed;
  #before = [];
  #key = "";

  constructor(state, changed) {
    this.#state = state;
    this.#changed = changed;
  }

  /** Restore earlier measurements of this tab, or else those in a saved page. */
  open(name) {
    const { source } = this.#state;
    // A page that was saved again has a new identity.
    this.#key = ["amulor", location.pathname, name, source.saved ? document.lastModified : ""].join(
      " ",
    );
    let measurements = source.measurements ?? [];
    try {
      measurements = JSON.parse(sessionStorage.getItem(this.#key) ?? "null") ?? measurements;
    } catch {
      // Pages in frames of reports may have no storage.
    }
    this.#state.number = Math.max(0, ...measurements.map((kept) => kept.number));
    this.#set([...measurements]);
  }

  get undoable() {
    return this.#before.length > 0;
  }

  change(measurements) {
    this.#before.push(this.#state.measurements);
    this.#set(measurements);
  }

  undo() {
    if (this.undoable) this.#set(this.#before.pop());
  }

  #set(measurements) {
    this.#state.measurements = measurements;
    try {
      sessionStorage.setItem(this.#key, JSON.stringify(measurements));
    } catch {
      // If the storage is full or forbidden, the record lasts as long as the page.
    }
    this.#changed();
  }
}

/** Return objects with the same keys as a table of comma-separated values. */
export function table(rows) {
  const cell = (value) => {
    const text = String(value ?? "");
    return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const names = Object.keys(rows[0] ?? {});
  return [names, ...rows.map((row) => names.map((name) => row[name]))]
    .map((line) => `${line.map(cell).join(",")}\n`)
    .join("");
}

/** Connect the buttons below the list to the record. */
export function wireRecord(state, { download, hint, stem, text, rows, content }) {
  const file = (ending, made, type) =>
    download(`${stem()}-measurements.${ending}`, new Blob([made], { type }));
  const clicks = {
    copy: () =>
      navigator.clipboard.writeText(text()).then(
        () => hint("Copied."),
        () => file("txt", text(), "text/plain"),
      ),
    "measured-csv": () => file("csv", table(rows()), "text/csv"),
    "measured-json": () =>
      file("json", `${JSON.stringify(content(), null, 2)}\n`, "application/json"),
    undo: () => state.record.undo(),
    clear: () => state.record.change([]),
  };
  for (const [id, act] of Object.entries(clicks)) $(id).addEventListener("click", act);
  document.addEventListener("keydown", (event) => {
    if (
      !(event.ctrlKey || event.metaKey) ||
      event.shiftKey ||
      event.key.toLowerCase() !== "z" ||
      event.target instanceof HTMLInputElement ||
      event.target instanceof HTMLTextAreaElement
    )
      return;
    event.preventDefault();
    state.record.undo();
  });
}
