// Panels beside the views: messages, values of a point, flags, measurements.

import { explained, flagColour } from "./colour.js";
import { $, made } from "./dom.js";

/** Show a message; an empty one hides it. */
export function say(text) {
  $("message").textContent = text;
  $("message").hidden = !text;
}

/** Hide a message, unless another one has replaced it. */
export function unsay(text) {
  if ($("message").textContent === text) say("");
}

/** Show an error, and mark the page as failed. */
export function failed(error) {
  say(error.message ?? String(error));
  document.documentElement.dataset.failed = "yes";
}

function swatch(text, colour) {
  const mark = made("i", {});
  mark.style.background = colour;
  return made("span", {}, mark, text);
}

/** Show in the legend the fraction of values with each flag. */
export function showLegend(values, flags) {
  const share = (count) => `${((100 * count) / values.length).toFixed(1)} %`;
  const counted = flags
    .map((flag) => [flag, values.reduce((sum, bits) => sum + (bits & flag.mask ? 1 : 0), 0)])
    .filter(([, count]) => count);
  const good = values.reduce((sum, bits) => sum + (bits === 0 ? 1 : 0), 0);
  const entries = [
    [`good, ${share(good)}`, "#2c7f62"],
    ...counted.map(([flag, count]) => [
      `${flag.name}, ${share(count)}: ${flag.words}`,
      flagColour(flag.name),
    ]),
  ];
  const asked = counted
    .slice(0, 1)
    .map(([flag]) =>
      made("span", { textContent: `More of each: amulor explain ${explained(flag.name)}` }),
    );
  $("legend").replaceChildren(...entries.map(([text, colour]) => swatch(text, colour)), ...asked);
}

/** Show names with their values, and the descriptions of flags. */
export function showReadout(rows, flags) {
  $("readout").replaceChildren(
    ...rows.flatMap(([term, text, kind]) => [
      made("dt", { textContent: term }),
      made("dd", { textContent: text, className: kind }),
    ]),
    ...flags.map((flag) =>
      made(
        "dd",
        { className: "words", title: `amulor explain ${explained(flag.name)}` },
        swatch(flag.words, flagColour(flag.name)),
      ),
    ),
  );
}

/** Letters of a name. */
const LONGEST_NAME = 60;

/** Give a measurement a name; this can be undone. */
function renamed(state, kept, name) {
  const named = { ...kept, name };
  if (state.chosen === kept) state.chosen = named;
  state.record.change(state.measurements.map((one) => (one === kept ? named : one)));
}

/** List measurements; `said` returns value, text, doubt and figure of one, `changed` redraws. */
export function listMeasurements(state, said, changed) {
  const again = () => {
    listMeasurements(state, said, changed);
    changed();
  };
  const none = !state.measurements.length;
  $("kept").hidden = none && !state.record.undoable;
  for (const id of ["copy", "measured-csv", "measured-json", "clear"]) $(id).hidden = none;
  $("undo").hidden = !state.record.undoable;
  $("measurements").replaceChildren(
    ...state.measurements.map((kept) => {
      const { main, words, doubt, figure } = said(kept);
      const remove = made("button", {
        type: "button",
        className: "remove",
        textContent: "×",
        ariaLabel: `Remove measurement ${kept.number}`,
      });
      remove.addEventListener("click", (event) => {
        event.stopPropagation();
        state.record.change(state.measurements.filter((one) => one !== kept));
      });
      const select = made("button", {
        type: "button",
        className: "number",
        textContent: kept.number,
        ariaLabel: `Select measurement ${kept.number}`,
        ariaPressed: String(kept === state.chosen),
      });
      const name = made("input", {
        className: "name",
        value: kept.name ?? "",
        placeholder: "name",
        maxLength: LONGEST_NAME,
        ariaLabel: `Name of measurement ${kept.number}`,
      });
      name.addEventListener("click", (event) => event.stopPropagation());
      name.addEventListener("change", () => renamed(state, kept, name.value.trim()));
      const li = made(
        "li",
        { className: kept === state.chosen ? "chosen" : "" },
        made("div", { className: doubt ? "value doubt" : "value" }, select, main),
        name,
        made("div", { className: "of", textContent: words }),
        ...(figure ? [figure] : []),
        remove,
      );
      li.addEventListener("click", () => {
        state.chosen = kept;
        again();
      });
      return li;
    }),
  );
}
