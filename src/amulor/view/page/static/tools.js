// Measuring: what is picked, what it comes to, and how far off it may be.

import { distance, height } from "./geometry.js";
import { withError, withUnit } from "./text.js";

// Kind, name on the button, how many points, and what to do in words.
export const TOOLS = [
  { kind: "distance", name: "distance", points: 2, hint: "Pick two points." },
  { kind: "height", name: "height", points: 2, hint: "Pick the lower point, then the upper one: height towards the surface.", axis: [0, -1, 0] },
  { kind: "depth", name: "relief", points: 2, hint: "Pick two points: how far the second stands towards the instrument.", axis: [0, 0, -1] },
  { kind: "angle", name: "angle", points: 3, hint: "Pick an end, the corner, and the other end." },
  { kind: "area", name: "area", points: Infinity, least: 3, hint: "Pick the corners in order; the first one again, or Enter, closes." },
  { kind: "plane", name: "plane", region: true, hint: "Drag a rectangle over a flat part of the map." },
  { kind: "circle", name: "circle", points: Infinity, least: 4, hint: "Pick at least four points on the rim; Enter fits." },
  { kind: "sphere", name: "sphere", region: true, hint: "Drag a rectangle over the ball on the map." },
  { kind: "cylinder", name: "cylinder", region: true, hint: "Drag a rectangle over the pipe on the map." },
];

export function toolOf(kind) {
  return TOOLS.find((tool) => tool.kind === kind);
}

/** Measure what was picked, by the server or in the page. */
export async function measured(state, tool, picks, region) {
  const { scene, source } = state;
  if (source.saved && (tool.kind === "distance" || tool.axis) && state.average === 0) {
    await Promise.all(scene.layers.filter((layer) => layer.kind === "hidden" || layer.name === "uncertainty").map((layer) => scene.load(layer.name)));
    return tool.kind === "distance" ? distance(scene, picks) : height(scene, picks, tool.axis);
  }
  const request = { kind: tool.axis ? "height" : tool.kind, channel: scene.channel, reach: state.average };
  if (tool.axis) request.axis = tool.axis;
  if (region) request.region = region;
  else request.pixels = picks;
  return source.measure(request);
}

const ANGLE = { "normal x": true, "normal y": true, "normal z": true };

/** Return a measurement as lines of text: the first one is the main one. */
export function worded(found) {
  const kept = found.lines.filter((line) => !ANGLE[line.label] && !/^(axis|point|centre) /.test(line.label));
  const main = found.doubt ? [found.doubt] : kept.map((line) => `${line.label === found.kind ? "" : `${line.label} `}${withError(line.value, line.uncertainty, line.unit)}`);
  const rests = [];
  if (found.random !== undefined) rests.push(`noise ${withUnit(found.random, found.lines[0].unit, 2)}`);
  if (found.residual !== undefined) rests.push(`residual ${withUnit(found.residual, "m", 2)}`);
  if (found.misfit) rests.push(`χ²/ν ${found.misfit.toFixed(2)}`);
  rests.push(`${found.pixels} pixels`);
  return { main, rests: rests.join(" · ") };
}

/** Return all measurements as a text that says what they rest on. */
export function asText(state) {
  const { scene } = state;
  const lines = [
    `${scene.title} (${scene.name}), channel ${scene.channel}`,
    `Metres in water of group index ${scene.group_index}; ± is one standard uncertainty, errors that pixels share included.`,
  ];
  if (scene.notes.some((note) => note.startsWith("Not in"))) lines.push(scene.notes.find((note) => note.startsWith("Not in")));
  for (const kept of state.measurements) {
    const name = toolOf(kept.kind).name;
    lines.push("", `${kept.number}. ${name}`);
    if (kept.found.doubt) lines.push(`   ${kept.found.doubt}`);
    for (const line of kept.found.lines) lines.push(`   ${line.label}: ${withError(line.value, line.uncertainty, line.unit)}`);
    lines.push(`   ${worded(kept.found).rests}`);
    const where = kept.region ? `rows ${kept.region[0]} to ${kept.region[2]}, columns ${kept.region[1]} to ${kept.region[3]}` : kept.picks.map(([row, column]) => `(${row}, ${column})`).join(" ");
    lines.push(`   ${kept.region ? where : `pixels (row, column) ${where}`}`);
  }
  return `${lines.join("\n")}\n`;
}
