// Themes of the page: light, dark, and high contrast for sunlight.

import { $ } from "./dom.js";

/** Order in which the button changes themes. */
const THEMES = ["light", "dark", "contrast"];
const NAMES = { light: "light", dark: "dark", contrast: "high contrast" };
const KEPT = "amulor theme";

/** Return the theme that was chosen in this tab, or else the one that the system prefers. */
export function firstTheme() {
  try {
    const chosen = sessionStorage.getItem(KEPT);
    if (chosen && THEMES.includes(chosen)) return chosen;
  } catch {
    // Pages in frames of reports may have no storage.
  }
  if (matchMedia("(prefers-contrast: more)").matches) return "contrast";
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}

/** Apply the theme after the present one, and remember it; return its colors. */
export function nextTheme() {
  const next = following(document.documentElement.dataset.theme ?? "light");
  try {
    sessionStorage.setItem(KEPT, next);
  } catch {
    // Without storage, the theme lasts as long as the page.
  }
  return themed(next);
}

function following(name) {
  return THEMES[(THEMES.indexOf(name) + 1) % THEMES.length];
}

/** Apply a theme; return its colors for drawings. */
export function themed(name) {
  document.documentElement.dataset.theme = name;
  const words = `Theme: ${NAMES[name]}. Next: ${NAMES[following(name)]} (D)`;
  Object.assign($("theme"), { title: words, ariaLabel: words });
  return present();
}

/** Return the colors for drawings on paper, whatever the theme of the screen. */
export function paperColours() {
  const { dataset } = document.documentElement;
  const { theme } = dataset;
  dataset.theme = "light";
  const colours = present();
  dataset.theme = theme;
  return { ...colours, stage: "#ffffff", plate: "#ffffff", ground: [1, 1, 1] };
}

/** Return the colors of the present theme for drawings. */
function present() {
  const style = getComputedStyle(document.documentElement);
  const get = (key) => style.getPropertyValue(`--${key}`).trim();
  const rgb = (text) => [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16) / 255);
  return {
    ink: get("ink"),
    soft: get("soft"),
    line: get("line"),
    accent: get("accent"),
    band: get("band"),
    mark: get("mark"),
    under: get("under"),
    plate: get("card"),
    stage: get("stage"),
    chosen: get("chosen"),
    font: getComputedStyle(document.body).fontFamily || "sans-serif",
    ground: rgb(get("stage")),
    missing: rgb(get("missing")),
  };
}
