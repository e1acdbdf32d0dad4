// Sheet of paper that the browser prints in place of the page.

import { $, inkOf, made } from "./dom.js";
import { colourBar } from "./map.js";
import { splitOf } from "./stage.js";
import { paperColours } from "./theme.js";

/** Place for the pictures of a sheet [page pixel]. */
const PLACE = { width: 700, height: 640 };
const GAP = 12;
/** Canvas pixels per page pixel: about 300 dots per inch on A4. */
const RATIO = 3;

/**
 * View that is drawn for paper, with its caption and its height for a width [page pixel].
 * @typedef {object} Picture
 * @property {HTMLCanvasElement} canvas
 * @property {string} name
 * @property {(width: number) => number} high
 * @property {(colours: any) => void} draw
 */
/**
 * Content of a sheet.
 * @typedef {object} Content
 * @property {string} title
 * @property {string[]} words description of the data, one line each
 * @property {Picture[]} pictures
 * @property {import("./stage.js").Shape} shape of the scan
 * @property {any} bar color scale, or null
 * @property {Record<string, string>[]} rows of the table of measurements
 * @property {string[]} notes
 */

/** Draw a view at the resolution of paper; return the picture. */
function pictured({ canvas, draw, high }, colours, cell) {
  const tall = high(cell.width);
  const share = Math.min(cell.height / tall, 1);
  // A picture that is too tall for its place becomes narrower.
  const width = high(cell.width * share) <= cell.height + 1 ? cell.width * share : cell.width;
  const height = Math.min(high(width), cell.height);
  const before = [canvas.width, canvas.height];
  [canvas.width, canvas.height] = [width, height].map((side) => Math.round(side * RATIO));
  canvas.dataset.ratio = String(RATIO);
  draw(colours);
  const picture = made("canvas", { width: canvas.width, height: canvas.height });
  picture.style.width = `${(100 * width) / cell.width}%`;
  inkOf(picture).drawImage(canvas, 0, 0);
  delete canvas.dataset.ratio;
  [canvas.width, canvas.height] = before;
  return picture;
}

function scaleOf(bar, colours) {
  const strip = made("canvas", { width: 1700, height: 90 });
  colourBar(strip, bar.table, bar.limits, bar.unit, colours, 2.6);
  const textContent = `${bar.label}${bar.unit ? ` [${bar.unit}]` : ""}`;
  return made("div", { className: "scale" }, strip, made("span", { textContent }));
}

function tableOf(rows) {
  if (!rows.length) return made("p", { textContent: "No measurements." });
  const line = (tag, texts) =>
    made("tr", {}, ...texts.map((textContent) => made(tag, { textContent })));
  return made(
    "table",
    {},
    made("thead", {}, line("th", Object.keys(rows[0]))),
    made("tbody", {}, ...rows.map((row) => line("td", Object.values(row)))),
  );
}

/**
 * Write the sheet, which only paper shows.
 * @param {Content} content
 */
function written({ title, words, pictures, shape, bar, rows, notes }) {
  const colours = paperColours();
  const several = pictures.length > 1;
  const beside = several && splitOf(shape, PLACE) === "row";
  const cell = {
    width: beside ? (PLACE.width - GAP) / 2 : PLACE.width,
    height: several && !beside ? (PLACE.height - GAP) / 2 : PLACE.height,
  };
  const figures = pictures.map((picture) =>
    made(
      "figure",
      {},
      pictured(picture, colours, cell),
      made("figcaption", { textContent: picture.name }),
    ),
  );
  const lines = (texts, className) =>
    texts.map((textContent) => made("p", { textContent, className }));
  $("sheet").replaceChildren(
    made("h1", { textContent: title }),
    ...lines(words, "words"),
    made("div", { className: beside ? "figures beside" : "figures" }, ...figures),
    ...(bar ? [scaleOf(bar, colours)] : []),
    tableOf(rows),
    ...lines(notes, "note"),
  );
}

/**
 * Write the sheet before the browser prints; `after` draws the views on the screen again.
 * @param {() => Content | null} content
 * @param {() => void} after
 */
export function printable(content, after) {
  addEventListener("beforeprint", () => {
    const present = content();
    if (present) written(present);
    after();
  });
}
