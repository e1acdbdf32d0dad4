// Scans of a site: which are shown, and the uncertainties of their poses.

import { $, made } from "./dom.js";
import { withUnit } from "./text.js";

/** @typedef {{name: string, visit: string, colour: number[], points: number, position_uncertainty: number, attitude_uncertainty: number}} Scan */

/**
 * List the scans with check boxes; `hide` gets the numbers of hidden ones.
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
  const visits = [...new Set(scans.map(({ visit }) => visit))];
  const button = (text, shown) => {
    const element = made("button", { type: "button", className: "mini", textContent: text });
    element.addEventListener("click", () => {
      boxes.forEach((box, at) => {
        box.checked = shown(scans[at]);
      });
      changed();
    });
    return element;
  };
  $("visits").replaceChildren(
    button("all", () => true),
    ...(visits.length > 1 ? visits.map((one) => button(one, ({ visit }) => visit === one)) : []),
  );
  $("scans").replaceChildren(...entries);
  $("scans-card").hidden = false;
}
