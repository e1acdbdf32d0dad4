// Stage: arrangement of the map, the 3-D view and the drawer of plots.

import { $ } from "./dom.js";

/** @typedef {{across: number, down: number}} Shape of a scan, in any unit */
/** @typedef {"both" | "map" | "cloud"} Choice */

/** Space of a map for its axes, and for the line of buttons above it [page pixel]. */
const AROUND = { across: 53, down: 70 };
const GAP = 10;
/** Narrower stages show one view; lower or slimmer windows begin without plots [page pixel]. */
const NARROW = 560;
const LOW = 760;
const SLIM = 900;
const KEYS = { views: "amulor views", plots: "amulor plots" };
const NEXT = { both: "map", map: "cloud", cloud: "both" };

/**
 * Return whether two views lie side by side ("row") or one above the other ("column"): the
 * arrangement that draws the map larger.
 * @param {Shape} shape
 * @param {{width: number, height: number}} size
 */
export function splitOf({ across, down }, { width, height }) {
  const scale = (/** @type {number} */ wide, /** @type {number} */ high) =>
    Math.min((wide - AROUND.across) / across, (high - AROUND.down) / down);
  const beside = scale((width - GAP) / 2, height);
  return beside >= scale(width, (height - GAP) / 2) ? "row" : "column";
}

function recalled(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    // Pages in frames of reports may have no storage.
    return null;
  }
}

function remember(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch {
    // Without storage, the arrangement lasts as long as the page.
  }
}

/** Arrangement of the views, which the user changes and the browser remembers. */
export class Stage {
  /** @type {Shape} */
  #shape = { across: 1, down: 1 };
  /** @type {Choice} */
  #choice;
  #open;
  #changed;

  constructor(changed) {
    this.#changed = changed;
    const choice = recalled(KEYS.views) ?? "both";
    this.#choice = choice in NEXT ? /** @type {Choice} */ (choice) : "both";
    const roomy = innerHeight >= LOW && innerWidth > SLIM;
    this.#open = (recalled(KEYS.plots) ?? (roomy ? "open" : "closed")) === "open";
    for (const button of $("views").children)
      button.addEventListener("click", () => this.choose(button.dataset.view));
    $("drawer-toggle").addEventListener("click", () => this.toggle());
  }

  /** Whether a view, or the plots, can be seen. */
  shows(name) {
    if (name === "plots") return this.#open && $("plots").clientHeight > 0;
    const { split } = $("stage-card").dataset;
    return split === "row" || split === "column" || split === name;
  }

  /** Arrange the views for the shape of a scan and the size of the window. */
  arrange(shape = this.#shape) {
    this.#shape = shape;
    const { clientWidth: width, clientHeight: height } = $("stages");
    // Paper shows no stage.
    if (!width) return;
    const narrow = width < NARROW;
    const alone = narrow && this.#choice === "both" ? "map" : this.#choice;
    $("stage-card").dataset.split = alone === "both" ? splitOf(shape, { width, height }) : alone;
    for (const button of $("views").children) {
      button.setAttribute("aria-pressed", String(button.dataset.view === alone));
      button.hidden = narrow && button.dataset.view === "both";
    }
    $("plots").hidden = !this.#open;
    $("drawer-toggle").setAttribute("aria-expanded", String(this.#open));
    $("drawer-toggle").textContent = this.#open ? "▾ hide" : "▴ profile, histogram, spectrum";
  }

  choose(choice) {
    this.#choice = choice;
    remember(KEYS.views, choice);
    this.#rearranged();
  }

  /** Show the next view: map, 3-D view, both. */
  next() {
    const { split } = $("stage-card").dataset;
    const present = split === "map" || split === "cloud" ? split : "both";
    const following = NEXT[present];
    const skips = following === "both" && $("stages").clientWidth < NARROW;
    this.choose(skips ? "map" : following);
  }

  /** Show a view that a tool draws on. */
  need(view) {
    if (!this.shows(view)) this.choose(view);
  }

  /** Open or close the drawer of plots. */
  toggle() {
    this.#open = !this.#open;
    remember(KEYS.plots, this.#open ? "open" : "closed");
    this.#rearranged();
  }

  #rearranged() {
    this.arrange();
    // The size of the stage follows from the drawer.
    this.arrange();
    this.#changed();
  }
}
