// Picture of a view with title, color scale and data source.

import { inkOf, ratioOf } from "./dom.js";
import { colourBar } from "./map.js";

/** Return a canvas with a view, its title above, color scale and text below. */
export function pictureOf({ view, title, words, bar, colours }) {
  const ratio = ratioOf(view);
  const width = Math.max(view.width, Math.round(420 * ratio));
  const edge = 14 * ratio;
  const canvas = document.createElement("canvas");
  const ctx = inkOf(canvas);
  const small = `${12 * ratio}px ${colours.font}`;
  ctx.font = small;
  const lines = words.flatMap((text) => wrapped(ctx, text, width - 2 * edge));
  const head = 36 * ratio;
  const scale = bar ? 40 * ratio : 0;
  canvas.width = width;
  canvas.height = Math.round(head + view.height + scale + lines.length * 16 * ratio + 2 * edge);
  ctx.fillStyle = colours.plate;
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.fillStyle = colours.ink;
  ctx.textBaseline = "middle";
  ctx.font = `600 ${15 * ratio}px ${colours.font}`;
  ctx.fillText(title, edge, head / 2 + ratio, width - 2 * edge);
  ctx.drawImage(view, Math.round((width - view.width) / 2), head);
  let low = head + view.height + edge;
  if (bar) {
    const strip = document.createElement("canvas");
    strip.width = width - 2 * edge - 60 * ratio;
    strip.height = 32 * ratio;
    colourBar(strip, bar.table, bar.limits, bar.unit, colours, ratio);
    ctx.drawImage(strip, edge, low);
    ctx.font = small;
    ctx.fillStyle = colours.ink;
    ctx.fillText(
      `${bar.label}${bar.unit ? ` [${bar.unit}]` : ""}`.slice(0, 24),
      edge + strip.width + 8 * ratio,
      low + 8 * ratio,
      64 * ratio,
    );
    low += scale;
  }
  ctx.font = small;
  ctx.fillStyle = colours.soft;
  lines.forEach((text, k) => ctx.fillText(text, edge, low + (k + 0.5) * 16 * ratio));
  return canvas;
}

/** Return a canvas as the bytes of a PNG file. */
export function png(canvas) {
  return new Promise((done, fail) => {
    canvas.toBlob(
      (blob) => (blob ? done(blob) : fail(new Error("The browser made no picture of this view."))),
      "image/png",
    );
  });
}

function wrapped(ctx, text, width) {
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines.at(-1)} ${word}`.trim();
    if (lines.at(-1) && ctx.measureText(longer).width > width) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  return lines;
}

/** Download bytes as a file. */
export function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
