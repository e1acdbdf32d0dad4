// Overlays of a view: lines visible on any color, picks, axes and a scale bar.

import { ticks, withUnit } from "./text.js";

const AXES = ["#D55E00", "#009E73", "#0072B2"];

/** Begin a path along positions. */
export function polyline(ctx, spots) {
  ctx.beginPath();
  spots.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
}

/** Stroke a path white on black, visible on any color; a selected path has the marking color,
which no map contains, along its middle. */
export function halo(ctx, width, colours, path, chosen = false) {
  ctx.save();
  ctx.lineJoin = "round";
  const strokes = [
    [colours.under, chosen ? 4 : 3],
    [colours.mark, chosen ? 2.4 : 1],
  ];
  if (chosen) strokes.push([colours.chosen, 1.2]);
  for (const [colour, times] of strokes) {
    path();
    ctx.lineWidth = width * times;
    ctx.strokeStyle = colour;
    ctx.stroke();
  }
  ctx.restore();
}

/** Draw a dot at a position: black, white, and a center that shows whether it is selected. */
export function dot(ctx, [x, y], size, colours, chosen = false) {
  ctx.save();
  const discs = [
    [colours.under, 1.3],
    [colours.mark, 1],
    [chosen ? colours.chosen : colours.under, 0.6],
  ];
  for (const [colour, times] of discs) {
    ctx.beginPath();
    ctx.arc(x, y, size * times, 0, 7);
    ctx.fillStyle = colour;
    ctx.fill();
  }
  ctx.restore();
}

/** Draw a short text on a background. */
export function tag(ctx, text, [x, y], ratio, colours) {
  ctx.save();
  ctx.font = `600 ${12 * ratio}px ${colours.font}`;
  const width = ctx.measureText(text).width + 9 * ratio;
  x = Math.max(Math.min(x, ctx.canvas.width - width), 0);
  ctx.fillStyle = colours.plate;
  ctx.beginPath();
  ctx.roundRect(x, y - 9 * ratio, width, 18 * ratio, 5 * ratio);
  ctx.fill();
  ctx.fillStyle = colours.ink;
  ctx.textBaseline = "middle";
  ctx.fillText(text, x + 4.5 * ratio, y + ratio);
  ctx.restore();
}

/** Draw the picks of one measurement: dots, lines between them, and its number with the name;
the selected one has its result, too. */
export function chain(ctx, spots, kept, ratio, colours, label = spots[0]) {
  const { kind, number, strong, name, text } = kept;
  if (spots.length > 1 && kind !== "circle") {
    const line = kind === "area" ? [...spots, spots[0]] : spots;
    halo(ctx, 1.5 * ratio, colours, () => polyline(ctx, line), strong);
  }
  for (const spot of spots) dot(ctx, spot, 4.5 * ratio, colours, strong);
  if (number && label) {
    const words = [number, name, strong && text].filter(Boolean).join("  ");
    tag(ctx, words, [label[0] + 8 * ratio, label[1] - 8 * ratio], ratio, colours);
  }
}

/** Draw all measurements, and the picks of the unfinished one. */
export function chains(ctx, state, spotOf, ratio, colours) {
  const { measurements, chosen, tool, picks } = state;
  const all = measurements.map((kept) => ({
    ...kept,
    strong: kept === chosen,
    text: state.texts?.(kept),
  }));
  for (const one of [...all, { kind: tool, picks, strong: true }]) {
    chain(ctx, (one.picks ?? []).map(spotOf).filter(Boolean), one, ratio, colours);
  }
}

/** Draw the names of annotations at their places. */
export function annotated(ctx, annotations, spotOf, ratio, colours) {
  for (const note of annotations) {
    const spot = spotOf(note);
    if (!spot) continue;
    dot(ctx, spot, 3.5 * ratio, colours);
    tag(ctx, note.name, [spot[0] + 8 * ratio, spot[1] + 12 * ratio], ratio, colours);
  }
}

/** Draw three labeled axes, in camera directions, in a corner of the view. */
export function axes(ctx, camera, named, ratio, colours) {
  const { right, up, forward } = camera.frame();
  const inner = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const [x0, y0] = [62 * ratio, ctx.canvas.height - 42 * ratio];
  ctx.save();
  ctx.font = `${12 * ratio}px ${colours.font}`;
  ctx.textBaseline = "middle";
  ctx.lineWidth = 2 * ratio;
  named
    .map(([name, axis], k) => ({
      name,
      colour: AXES[k],
      x: inner(axis, right),
      y: -inner(axis, up),
      z: inner(axis, forward),
    }))
    .sort((a, b) => b.z - a.z)
    .forEach(({ name, colour, x, y }) => {
      ctx.strokeStyle = colour;
      ctx.beginPath();
      ctx.moveTo(x0, y0);
      ctx.lineTo(x0 + x * 20 * ratio, y0 + y * 20 * ratio);
      ctx.stroke();
      if (Math.hypot(x, y) < 0.35) return;
      ctx.fillStyle = colours.soft;
      ctx.textAlign = x < -0.3 ? "right" : x > 0.3 ? "left" : "center";
      ctx.fillText(name, x0 + x * 25 * ratio, y0 + y * 27 * ratio);
    });
  ctx.restore();
}

/** Draw the axes of a map left of and below it: `box` of the map, and for each axis its label
and its ticks with positions [canvas pixel]. */
export function mapAxes(ctx, box, { across, down }, ratio, colours) {
  ctx.save();
  ctx.font = `${12 * ratio}px ${colours.font}`;
  ctx.fillStyle = ctx.strokeStyle = colours.soft;
  ctx.lineWidth = ratio;
  ctx.beginPath();
  ctx.textAlign = "center";
  ctx.textBaseline = "top";
  for (const { at, text } of across.ticks) {
    ctx.moveTo(at, box.bottom);
    ctx.lineTo(at, box.bottom + 4 * ratio);
    ctx.fillText(text, at, box.bottom + 6 * ratio);
  }
  ctx.textAlign = "right";
  ctx.fillText(across.label, box.right, box.bottom + 19 * ratio);
  ctx.textBaseline = "middle";
  for (const { at, text } of down.ticks) {
    ctx.moveTo(box.left, at);
    ctx.lineTo(box.left - 4 * ratio, at);
    ctx.fillText(text, box.left - 6 * ratio, at);
  }
  ctx.stroke();
  ctx.translate(box.left - 37 * ratio, box.top);
  ctx.rotate(-Math.PI / 2);
  ctx.fillText(down.label, 0, 0);
  ctx.restore();
}

function whole({ canvas }) {
  return { right: canvas.width, bottom: canvas.height };
}

/** Draw a scale bar for a number of pixels per meter, with text after its length; return the
length in meters and pixels. It is in the lower right corner of a box, by default the canvas. */
export function scaleBar(ctx, perMetre, ratio, colours, words = "", box = whole(ctx)) {
  const { right: width, bottom: height, most = Infinity } = box;
  const { step } = ticks(0, Math.min(150 * ratio, most) / perMetre, 1.2);
  const length = step * perMetre;
  const [end, low] = [width - 18 * ratio, height - 20 * ratio];
  const text = `${withUnit(step, "m", 2)}${words}`;
  ctx.save();
  ctx.font = `${12 * ratio}px ${colours.font}`;
  const half = Math.max(length, ctx.measureText(text).width) / 2 + 6 * ratio;
  const middle = Math.min(end - length / 2, width - half - 4 * ratio);
  ctx.fillStyle = colours.plate;
  ctx.globalAlpha = 0.85;
  ctx.beginPath();
  ctx.roundRect(middle - half, low - 23 * ratio, 2 * half, 29 * ratio, 5 * ratio);
  ctx.fill();
  ctx.globalAlpha = 1;
  ctx.strokeStyle = ctx.fillStyle = colours.ink;
  ctx.lineWidth = 2 * ratio;
  ctx.beginPath();
  ctx.moveTo(end - length, low - 5 * ratio);
  ctx.lineTo(end - length, low);
  ctx.lineTo(end, low);
  ctx.lineTo(end, low - 5 * ratio);
  ctx.stroke();
  ctx.textAlign = "center";
  ctx.fillText(text, middle, low - 8 * ratio);
  ctx.restore();
  return { metres: step, pixels: length };
}
