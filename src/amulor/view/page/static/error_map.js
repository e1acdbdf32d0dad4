// Map of the total error: colors, contour lines, hatched regions and a marker.

import { segments } from "./contours.js";
import { inkOf, over, ratioOf, spotOn } from "./dom.js";
import { clearedOver } from "./map.js";
import { dot } from "./marks.js";
import { ticks } from "./text.js";

/** Errors at both ends of the color scale [mm]. */
export const LIMITS = [0.1, 100];
/** Contour line: white on a dark border. */
const LINES = [
  { width: 3.4, colour: "rgba(8, 24, 34, 0.6)" },
  { width: 1.6, colour: "#ffffff" },
];
const EDGE = { left: 56, right: 14, top: 12, bottom: 42 };

/** Return the hatch pattern of a region. */
export function hatch(context, number, ratio) {
  const size = Math.round(9 * ratio);
  const tile = document.createElement("canvas");
  tile.width = size;
  tile.height = size;
  const ink = inkOf(tile);
  ink.strokeStyle = "rgba(255, 255, 255, 0.85)";
  ink.fillStyle = ink.strokeStyle;
  ink.lineWidth = 1.2 * ratio;
  const line = (x0, y0, x1, y1) => {
    ink.beginPath();
    ink.moveTo(x0, y0);
    ink.lineTo(x1, y1);
    ink.stroke();
  };
  if (number === 1) {
    ink.beginPath();
    ink.arc(size / 2, size / 2, 1.6 * ratio, 0, 7);
    ink.fill();
  } else {
    for (const shift of [-size, 0, size]) {
      line(shift, size, shift + size, 0);
      if (number === 2) line(shift, 0, shift + size, size);
    }
  }
  return context.createPattern(tile, "repeat");
}

/** Return the color index, 0 to 255, of the logarithm of an error. */
export function shade(value) {
  const [low, high] = LIMITS.map(Math.log);
  return Math.round((255 * (Math.min(Math.max(Math.log(value), low), high) - low)) / (high - low));
}

/** View of the error map, which converts screen positions to map positions. */
export class ErrorMap {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = inkOf(canvas);
    this.over = inkOf(over(canvas));
    this.image = document.createElement("canvas");
  }

  /** Return the corners of the map on the canvas [canvas pixel]. */
  frame(ratio) {
    const { width, height } = this.canvas;
    return {
      x0: EDGE.left * ratio,
      x1: width - EDGE.right * ratio,
      y0: EDGE.top * ratio,
      y1: height - EDGE.bottom * ratio,
    };
  }

  /** Return grid column and row at a screen position; null outside the map. */
  place(event, scene) {
    const { x0, x1, y0, y1 } = this.frame(this.canvas.width / this.canvas.clientWidth);
    const [x, y] = spotOn(this.canvas, event);
    if (x < x0 || x > x1 || y < y0 || y > y1) return null;
    const at = (share, count) => Math.round(share * (count - 1));
    return [
      at((x - x0) / (x1 - x0), scene.distance.length),
      at((y1 - y) / (y1 - y0), scene.attenuation.length),
    ];
  }

  /** Draw the marker on a separate layer. */
  point({ scene, mark, colours }) {
    const ctx = clearedOver(this.over, this.canvas, mark);
    if (!mark) return;
    const ratio = ratioOf(this.canvas);
    const { x0, x1, y0, y1 } = this.frame(ratio);
    const x = x0 + (mark[0] * (x1 - x0)) / (scene.distance.length - 1);
    const y = y1 - (mark[1] * (y1 - y0)) / (scene.attenuation.length - 1);
    dot(ctx, [x, y], 6 * ratio, colours, true);
  }

  draw({ scene, found, colours, table }) {
    const ctx = this.context;
    const ratio = ratioOf(this.canvas);
    const wide = scene.distance.length;
    const high = scene.attenuation.length;
    const { x0, x1, y0, y1 } = this.frame(ratio);
    const stepX = (x1 - x0) / (wide - 1);
    const stepY = (y1 - y0) / (high - 1);
    const toX = (column) => x0 + column * stepX;
    const toY = (row) => y1 - row * stepY;
    ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.#colours(found.error, wide, high, table);
    ctx.save();
    ctx.beginPath();
    ctx.rect(x0, y0, x1 - x0, y1 - y0);
    ctx.clip();
    // Values belong to the centers of image pixels; the outermost lie on the frame.
    ctx.imageSmoothingEnabled = true;
    ctx.drawImage(this.image, x0 - stepX / 2, y0 - stepY / 2, wide * stepX, high * stepY);
    scene.regions.forEach((region, number) =>
      this.#region({
        found,
        bit: region.bit,
        wide,
        high,
        x0: x0 - stepX / 2,
        y1: y1 + stepY / 2,
        stepX,
        stepY,
        fill: hatch(ctx, number, ratio),
      }),
    );
    const logarithm = Float64Array.from(found.error, (value) =>
      value === null ? NaN : Math.log(value),
    );
    for (const level of scene.contours)
      this.#line(
        segments(logarithm, wide, high, Math.log(level)),
        `${level} mm`,
        toX,
        toY,
        ratio,
        colours,
      );
    for (const [distance, attenuation] of scene.asked) {
      const column = placeIn(scene.distance, distance);
      const row = placeIn(scene.attenuation, attenuation);
      dot(ctx, [toX(column), toY(row)], 4.5 * ratio, colours);
    }
    ctx.restore();
    this.#axes({ scene, ratio, colours, x0, x1, y0, y1, toX, toY });
  }

  #colours(error, wide, high, table) {
    const { image } = this;
    if (image.width !== wide || image.height !== high) {
      image.width = wide;
      image.height = high;
    }
    const ink = inkOf(image);
    const pixels = ink.createImageData(wide, high);
    for (let row = 0; row < high; row += 1) {
      for (let column = 0; column < wide; column += 1) {
        const value = error[row * wide + column];
        const at = 4 * ((high - 1 - row) * wide + column);
        const from = 4 * (value === null ? 255 : shade(value));
        for (let k = 0; k < 4; k += 1) pixels.data[at + k] = table[from + k];
      }
    }
    ink.putImageData(pixels, 0, 0);
  }

  #region({ found, bit, wide, high, x0, y1, stepX, stepY, fill }) {
    const ctx = this.context;
    ctx.beginPath();
    for (let row = 0; row < high; row += 1) {
      let first = -1;
      for (let column = 0; column <= wide; column += 1) {
        const inside = column < wide && found.flags[row * wide + column] & bit;
        if (inside && first < 0) first = column;
        if (!inside && first >= 0) {
          ctx.rect(x0 + first * stepX, y1 - (row + 1) * stepY, (column - first) * stepX, stepY);
          first = -1;
        }
      }
    }
    ctx.fillStyle = fill;
    ctx.fill();
  }

  #line(parts, label, toX, toY, ratio, colours) {
    if (!parts.length) return;
    const ctx = this.context;
    ctx.beginPath();
    for (const [a, b, c, d] of parts) {
      ctx.moveTo(toX(a), toY(b));
      ctx.lineTo(toX(c), toY(d));
    }
    for (const { width, colour } of LINES) {
      ctx.lineWidth = width * ratio;
      ctx.strokeStyle = colour;
      ctx.stroke();
    }
    const [a, b] = parts[Math.floor(parts.length / 2)];
    ctx.font = `600 ${12 * ratio}px ${colours.font}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    ctx.lineWidth = 3.5 * ratio;
    ctx.strokeStyle = "rgba(8, 24, 34, 0.85)";
    ctx.strokeText(label, toX(a), toY(b));
    ctx.fillStyle = "#ffffff";
    ctx.fillText(label, toX(a), toY(b));
  }

  #axes({ scene, ratio, colours, x0, x1, y0, y1, toX, toY }) {
    const ctx = this.context;
    ctx.strokeStyle = colours.soft;
    ctx.fillStyle = colours.ink;
    ctx.lineWidth = ratio;
    ctx.font = `${12 * ratio}px ${colours.font}`;
    ctx.beginPath();
    ctx.textAlign = "center";
    ctx.textBaseline = "top";
    for (const value of ticksOf(scene.distance)) {
      const x = toX(placeIn(scene.distance, value));
      ctx.moveTo(x, y1);
      ctx.lineTo(x, y1 + 4 * ratio);
      ctx.fillText(plain(value), x, y1 + 7 * ratio);
    }
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    for (const value of ticksOf(scene.attenuation)) {
      const y = toY(placeIn(scene.attenuation, value));
      ctx.moveTo(x0, y);
      ctx.lineTo(x0 - 4 * ratio, y);
      ctx.fillText(plain(value), x0 - 7 * ratio, y);
    }
    ctx.rect(x0, y0, x1 - x0, y1 - y0);
    ctx.stroke();
    ctx.fillStyle = colours.soft;
    ctx.textAlign = "center";
    ctx.fillText("distance [m]", (x0 + x1) / 2, y1 + 30 * ratio);
    ctx.save();
    ctx.translate(13 * ratio, (y0 + y1) / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.fillText("attenuation [1/m]", 0, 0);
    ctx.restore();
  }
}

function plain(value) {
  return String(Number(value.toPrecision(3)));
}

/** Return the fractional index of a value among increasing values. */
export function placeIn(values, value) {
  let at = 0;
  while (at + 2 < values.length && values[at + 1] < value) at += 1;
  return at + (value - values[at]) / (values[at + 1] - values[at]);
}

function ticksOf(values) {
  const low = values[0];
  const high = values.at(-1);
  const even = Math.abs(values[1] - values[0]) / Math.abs(values.at(-1) - values.at(-2)) > 0.99;
  if (even) return ticks(low, high, 7).values;
  const out = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
    for (const step of [1, 2, 5]) {
      const value = step * 10 ** power;
      if (value >= low * 0.999 && value <= high * 1.001) out.push(value);
    }
  }
  return out;
}
