// Measurements: picked points, results and uncertainties.

import { measuredHere } from "./offline.js";
import { withError, withUnit } from "./text.js";

/**
 * One measurement.
 * @typedef {object} Tool
 * @property {string} kind
 * @property {string} name on its button
 * @property {string} hint what to do
 * @property {number} [points] how many are picked
 * @property {number} [least] how many at least, where it is open
 * @property {boolean} [region] a rectangle is dragged
 * @property {boolean} [base] over a plane that was fitted before
 * @property {number[]} [axis] of heights
 */

/** @type {Tool[]} */
export const TOOLS = [
  { kind: "distance", name: "distance", points: 2, hint: "Pick two points." },
  {
    kind: "height",
    name: "height",
    points: 2,
    hint: "Pick the lower point, then the upper one: height towards the surface.",
    axis: [0, -1, 0],
  },
  {
    kind: "depth",
    name: "relief",
    points: 2,
    hint: "Pick two points: how far the second stands towards the instrument.",
    axis: [0, 0, -1],
  },
  { kind: "angle", name: "angle", points: 3, hint: "Pick an end, the corner, and the other end." },
  {
    kind: "area",
    name: "area",
    points: Infinity,
    least: 3,
    hint: "Pick the corners in order; the first one again, or Enter, closes.",
  },
  {
    kind: "plane",
    name: "plane",
    region: true,
    hint: "Drag a rectangle over a flat part of the map.",
  },
  {
    kind: "circle",
    name: "circle",
    points: Infinity,
    least: 4,
    hint: "Pick at least four points on the rim; Enter fits.",
  },
  {
    kind: "sphere",
    name: "sphere",
    region: true,
    hint: "Drag a rectangle over the ball on the map.",
  },
  {
    kind: "cylinder",
    name: "cylinder",
    region: true,
    hint: "Drag a rectangle over the pipe on the map.",
  },
  {
    kind: "volume",
    name: "volume",
    region: true,
    base: true,
    hint: "Fit a plane to the ground first, then drag a rectangle over the body and its edges.",
  },
  {
    kind: "profile",
    name: "half-profile",
    region: true,
    hint: "Drag a rectangle over the whole round object, such as a pot.",
  },
];

export function toolOf(kind) {
  return /** @type {Tool} */ (TOOLS.find((tool) => tool.kind === kind));
}

/** Return the rectangle of the plane over which a volume is measured: that of the selected
measurement, or else the latest. */
function baseOf({ measurements, chosen, scene }) {
  const planes = [...measurements, chosen].filter(
    (kept) =>
      kept?.kind === "plane" &&
      kept.region &&
      !kept.found.doubt &&
      channelOf(kept) === scene.channel,
  );
  if (!planes.length)
    throw new Error("Fit a plane to the ground first; the volume is the one over it.");
  return planes.at(-1).region;
}

/** Compute a measurement from its picks, by the server or in the page. */
export async function measured(state, tool, { picks, region, box }) {
  const { scene, source } = state;
  if (source.saved) {
    const base = tool.base ? baseOf(state) : null;
    const how = { picks, region, base, clip: box, reach: state.average };
    return measuredHere(scene, tool, how);
  }
  /** @type {Record<string, unknown>} */
  const request = {
    kind: tool.axis ? "height" : tool.kind,
    channel: scene.channel,
    reach: state.average,
  };
  if (tool.axis) request.axis = tool.axis;
  if (tool.base) request.base = baseOf(state);
  if (box) request.clip = box;
  if (region) request.region = region;
  else request.pixels = picks;
  return source.measure(request);
}

const ANGLE = { "normal x": true, "normal y": true, "normal z": true };

/** Return a measurement as lines of text, the main result first. */
export function worded(found) {
  const kept = found.lines.filter(
    (line) => !ANGLE[line.label] && !/^(axis|point|centre) /.test(line.label),
  );
  const numbers = kept.map(
    (line) =>
      `${line.label === found.kind ? "" : `${line.label} `}${withError(line.value, line.uncertainty, line.unit)}`,
  );
  // A plane is described by its tilt and its flatness.
  if (found.kind === "plane") numbers.splice(0, 2, numbers.slice(0, 2).join(", "));
  const main = found.doubt ? [found.doubt] : numbers;
  const rests = [];
  if (found.random !== undefined)
    rests.push(`noise ${withUnit(found.random, found.lines[0].unit, 2)}`);
  if (found.left_out) rests.push(`${found.left_out} pixels off it`);
  if (found.residual !== undefined) rests.push(`residual ${withUnit(found.residual, "m", 2)}`);
  if (found.misfit) rests.push(`χ²/ν ${found.misfit.toFixed(2)}`);
  if (found.error_unknown) rests.push(found.error_unknown);
  rests.push(`${found.pixels} pixels`);
  return { main, rests: rests.join(" · ") };
}

/** Return the mean place of the pixels of a measurement [m]; null without ranges. */
export function placeOf(scene, picks, region) {
  const pixels = region
    ? [
        [region[0], region[1]],
        [region[0], region[3]],
        [region[2], region[1]],
        [region[2], region[3]],
      ]
    : picks;
  const places = pixels.map((pixel) => scene.point(...pixel)).filter(Boolean);
  if (!places.length) return null;
  return [0, 1, 2].map((k) => places.reduce((sum, place) => sum + place[k], 0) / places.length);
}

/** Return channel and settings of a measurement. */
export function circumstances(state) {
  const { scene } = state;
  const wide = 2 * state.average + 1;
  return {
    file: scene.name,
    channel: scene.channel,
    map: scene.byName.get(state.layerName).label,
    water: scene.water_in ? "in" : "removed",
    averaged: state.region ? "1 × 1" : `${wide} × ${wide}`,
  };
}

const channelOf = (kept) => kept.found.channel ?? kept.channel ?? "";

/** Return name and main numbers of a measurement with its channel, for one line. */
export function captioned(kept) {
  const name = [kept.name, toolOf(kept.kind).name].filter(Boolean).join(", ");
  return `${kept.number}: ${name} ${worded(kept.found).main.join(", ")}${channelOf(kept) && ` (channel ${channelOf(kept)})`}`;
}

/** Return statements on the data of a sheet: settings, file with its digest, program, date. */
export function provenance(state, now = new Date()) {
  const { scene, raw, digest } = state;
  const water = raw || scene.water_in ? "water in" : "water removed";
  return [
    `Channel ${scene.channel}, ${water}. ${scene.error_unknown || "± is one standard uncertainty, errors that pixels share included"}.`,
    `File ${scene.name}${digest && `, ${digest}`}. amulor ${scene.version}, printed ${now.toISOString().slice(0, 10)}.`,
  ];
}

/** Return a measurement as a row of the printed table. */
export function tabled(kept) {
  const { main, rests } = worded(kept.found);
  const place = kept.place?.map((part) => (part * 1e3).toFixed(1).replace("-", "−")).join(", ");
  return {
    "No.": String(kept.number),
    name: kept.name ?? "",
    measurement: toolOf(kept.kind).name,
    result: main.join("; "),
    details: [rests, kept.clip && `clip box ${kept.clip}`].filter(Boolean).join(" · "),
    channel: channelOf(kept),
    "right, down, forward [mm]": place ?? "",
  };
}

function where(kept) {
  if (kept.region)
    return `rows ${kept.region[0]} to ${kept.region[2]}, columns ${kept.region[1]} to ${kept.region[3]}`;
  return kept.picks.map(([row, column]) => `(${row}, ${column})`).join(" ");
}

/** Return all measurements as rows of a table, one for each number, in SI units. */
export function asRows(state) {
  return state.measurements.flatMap((kept) => {
    const { found } = kept;
    const lines = found.lines.length ? found.lines : [{}];
    return lines.map(({ label, value, uncertainty, unit }) => ({
      number: kept.number,
      name: kept.name,
      kind: toolOf(kept.kind).name,
      quantity: label,
      value,
      standard_uncertainty: uncertainty,
      unit,
      doubt: found.doubt,
      noise: found.random,
      residual_m: found.residual,
      chi_square_per_degree_of_freedom: found.misfit,
      pixels: found.pixels,
      file: kept.file,
      channel: channelOf(kept),
      water: kept.water,
      map: kept.map,
      averaged: kept.averaged,
      clip_box: kept.clip,
      group_index: found.group_index,
      where_row_column: where(kept),
      place_right_m: kept.place?.[0],
      place_down_m: kept.place?.[1],
      place_forward_m: kept.place?.[2],
    }));
  });
}

/** Return all measurements as an object for programs, in SI units. */
export function asObject(state) {
  const { scene } = state;
  const measurements = state.measurements.map(({ kind, ...kept }) => ({
    ...kept,
    kind: toolOf(kind).name,
    channel: channelOf(kept),
  }));
  return {
    file: scene.name,
    title: scene.title,
    notes: scene.notes,
    uncertainties: "standard, errors that pixels share included",
    measurements,
  };
}

/** Return all measurements as text, with their data source. */
export function asText(state) {
  const { scene } = state;
  const lines = [
    `${scene.title} (${scene.name})`,
    `Meters in water of group index ${Number(scene.group_index.toPrecision(5))}; ${scene.error_unknown || "± is one standard uncertainty, errors that pixels share included"}.`,
  ];
  if (scene.notes.some((note) => note.startsWith("Not in")))
    lines.push(scene.notes.find((note) => note.startsWith("Not in")));
  for (const kept of state.measurements) {
    const name = toolOf(kept.kind).name;
    lines.push("", `${kept.number}. ${[kept.name, name].filter(Boolean).join(": ")}`);
    if (kept.found.doubt) lines.push(`   ${kept.found.doubt}`);
    for (const line of kept.found.lines)
      lines.push(`   ${line.label}: ${withError(line.value, line.uncertainty, line.unit)}`);
    lines.push(`   ${worded(kept.found).rests}`);
    lines.push(`   ${kept.region ? "" : "pixels (row, column) "}${where(kept)}`);
    const around = [
      `channel ${channelOf(kept)}`,
      kept.water && `water ${kept.water}`,
      kept.map && `map ${kept.map.toLowerCase()}`,
      kept.averaged && `means of ${kept.averaged} pixels`,
      kept.clip && `clip box ${kept.clip}`,
    ];
    lines.push(`   ${around.filter(Boolean).join(", ")}`);
  }
  return `${lines.join("\n")}\n`;
}
