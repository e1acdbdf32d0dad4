// Scans of a site: which are shown, and the uncertainties of their poses.

import { $, made } from "./dom.js";
import { withUnit } from "./text.js";

/** @typedef {{name: string, visit: string, colour: number[], points: number, position_uncertainty: number, attitude_uncertainty: number}} Scan */

/** @typedef {{source: string, target: string, points: number, distance: number, misfit: number, moved: number, directions: number, trust: number}} Pair */

/**
 * List the scans with check boxes; `hide` gets the numbers of hidden ones. Return a function
 * that hides scans by name.
 * @param {Scan[]} scans
 * @param {(hidden: Set<number>) => void} hide
 */
export function listScans(scans, hide) {
  const boxes = scans.map(({ name }) => made("input", { type: "checkbox", checked: true, name }));
  const changed = () => hide(new Set([...boxes.keys()].filter((at) => !boxes[at].checked)));
  const entries = scans.map((scan, at) => {
    const { name, visit, colour, position_uncertainty: sigma, points } = scan;
    const mark = made("i");
    mark.style.background = `rgb(${colour.join()})`;
    // The first scan is the reference of all poses.
    const pose = at ? `± ${withUnit(sigma, "m", 2)}` : "reference";
    const title = `${points.toLocaleString("en")} points, visit ${visit}; attitude ± ${(scan.attitude_uncertainty * 1e3).toFixed(3)} mrad`;
    const words = made("span", { className: "pose", textContent: `${visit} · ${pose}` });
    return made("label", { title }, boxes[at], mark, name, words);
  });
  for (const box of boxes) box.addEventListener("change", changed);
  /** Show the scans of a rule. @type {(shown: (scan: Scan) => boolean) => void} */
  const show = (shown) => {
    boxes.forEach((box, at) => {
      box.checked = shown(scans[at]);
    });
    changed();
  };
  const visits = [...new Set(scans.map(({ visit }) => visit))];
  const button = (text, shown) => {
    const element = made("button", { type: "button", className: "mini", textContent: text });
    element.addEventListener("click", () => show(shown));
    return element;
  };
  $("visits").replaceChildren(
    button("all", () => true),
    ...(visits.length > 1 ? visits.map((one) => button(one, ({ visit }) => visit === one)) : []),
  );
  $("scans").replaceChildren(...entries);
  $("scans-card").hidden = false;
  return (/** @type {string[]} */ hidden) => show(({ name }) => !hidden.includes(name));
}

/** Misfit above which a pair of scans scatters more than its errors explain. */
const SCATTERED = 1.5;

/**
 * Show the residuals of overlapping scans as a table.
 * @param {Pair[]} pairs
 */
export function tableOf(pairs) {
  const head = ["scans", "points", "mm", "misfit", "off", "held"];
  const cells = (tag, texts) => texts.map((textContent) => made(tag, { textContent }));
  const rows = pairs.map((pair) => {
    const { source, target, points, distance, misfit, moved, directions } = pair;
    const row = made(
      "tr",
      { title: pair.trust < 1 ? `counts ${(100 * pair.trust).toFixed(0)} %` : "" },
      made("th", { scope: "row", textContent: `${source} on ${target}` }),
      ...cells("td", [
        points.toLocaleString("en"),
        (distance * 1e3).toFixed(2),
        misfit.toFixed(2),
        moved.toLocaleString("en"),
        `${directions}/6`,
      ]),
    );
    if (misfit > SCATTERED) row.className = "wrong";
    return row;
  });
  const top = cells("th", head);
  for (const cell of top) cell.scope = "col";
  $("pairs").replaceChildren(made("thead", {}, made("tr", {}, ...top)), made("tbody", {}, ...rows));
  $("pairs-card").hidden = !pairs.length;
}
