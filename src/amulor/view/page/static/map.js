// Map of one layer: zoom, picks, lines and regions.

import { inkOf, over, ratioOf, spotOn } from "./dom.js";
import { interpolated } from "./geometry.js";
import { annotated, chain, dot, halo, mapAxes, polyline, scaleBar } from "./marks.js";
import { ticks, withUnit } from "./text.js";

/** Fit a canvas to its size on the screen; return whether it changed. */
export function fitted(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}

/** Margins for the axes of a map [page pixel]. */
const MARGIN = { left: 46, top: 7, right: 7, bottom: 34 };
/** Height for a scale bar below a map [page pixel]. */
const BAR = 46;

/** Return the overlay of a canvas, cleared and of equal size; hidden if it is not used. */
export function clearedOver(ctx, canvas, used) {
  ctx.canvas.hidden = !used;
  if (!used) return ctx;
  const { width, height } = canvas;
  if (ctx.canvas.width !== width || ctx.canvas.height !== height) {
    Object.assign(ctx.canvas, { width, height });
  }
  ctx.clearRect(0, 0, width, height);
  return ctx;
}

/** View of a map, which reports the pixel under the pointer. */
export class MapView {
  constructor(canvas, { hover, pick, drag }) {
    this.canvas = canvas;
    this.context = inkOf(canvas, { opaque: true });
    this.over = inkOf(over(canvas));
    this.zoom = 1;
    this.middle = null;
    this.pointers = new Map();
    this.on = { hover, pick, drag };
    this.#listen();
  }

  home() {
    this.zoom = 1;
    this.middle = null;
  }

  /** Return the height of a map of a given width, with axes and scale bar [page pixel]. */
  high(scene, width) {
    const map = ((width - MARGIN.left - MARGIN.right) * scene.high * scene.aspect) / scene.wide;
    return map + MARGIN.top + MARGIN.bottom + BAR;
  }

  /** Return the part of the canvas between the axes [canvas pixel]. */
  #box() {
    const { width, height } = this.canvas;
    const [left, top, right, bottom] = ["left", "top", "right", "bottom"].map(
      (side) => MARGIN[side] * ratioOf(this.canvas),
    );
    return {
      left,
      top,
      right: Math.max(width - right, left + 1),
      bottom: Math.max(height - bottom, top + 1),
    };
  }

  /** Return the part of the canvas on which the scan is drawn [canvas pixel]. */
  #ends(scene) {
    const view = this.view(scene);
    const box = this.#box();
    return {
      left: Math.max(box.left, -view.left / view.x),
      right: Math.min(box.right, (scene.wide - view.left) / view.x),
      top: Math.max(box.top, -view.top / view.y),
      bottom: Math.min(box.bottom, (scene.high - view.top) / view.y),
    };
  }

  /** Return column and row at the top left, and columns and rows per canvas pixel. */
  view(scene) {
    const box = this.#box();
    const [width, height] = [box.right - box.left, box.bottom - box.top];
    const tall = scene.high * scene.aspect;
    const perPixel = Math.max(scene.wide / width, tall / height) / this.zoom;
    const step = [perPixel, perPixel / scene.aspect];
    this.middle ??= [scene.wide / 2, scene.high / 2];
    const half = [(step[0] * width) / 2, (step[1] * height) / 2];
    const sizes = [scene.wide, scene.high];
    for (const k of [0, 1]) {
      const room = Math.max(sizes[k] / 2 - half[k], 0);
      this.middle[k] = Math.min(Math.max(this.middle[k], sizes[k] / 2 - room), sizes[k] / 2 + room);
    }
    return {
      left: this.middle[0] - half[0] - box.left * step[0],
      top: this.middle[1] - half[1] - box.top * step[1],
      x: step[0],
      y: step[1],
    };
  }

  /** Return the pixel of the scan at a screen position; null outside the map. */
  pixel(scene, event, kept = false) {
    const [x, y] = spotOn(this.canvas, event);
    const view = this.view(scene);
    const box = this.#box();
    const outside = x < box.left || x > box.right || y < box.top || y > box.bottom;
    if (outside && !kept) return null;
    let column = Math.floor(view.left + x * view.x);
    let row = Math.floor(view.top + y * view.y);
    if (kept) {
      column = Math.min(Math.max(column, 0), scene.wide - 1);
      row = Math.min(Math.max(row, 0), scene.high - 1);
    }
    if (column < 0 || row < 0 || column >= scene.wide || row >= scene.high) return null;
    return [
      Math.min(row * scene.stride, scene.rows - 1),
      Math.min(column * scene.stride, scene.columns - 1),
    ];
  }

  /** Return the position of a pixel's center on the canvas. */
  spot(scene, [row, column]) {
    const view = this.view(scene);
    return [
      (Math.floor(column / scene.stride) + 0.5 - view.left) / view.x,
      (Math.floor(row / scene.stride) + 0.5 - view.top) / view.y,
    ];
  }

  draw(state, colours) {
    const { scene, renderer } = state;
    const view = this.view(scene);
    this.scene = scene;
    const parts = scene.uniforms(state.layerName, state.limits, state.look);
    parts.set.uView = ["4f", view.left, view.top, view.x, view.y];
    renderer.drawMap(this.context, parts);
    this.#marks(state, colours);
    this.#axes(state, colours);
    this.point(state, colours);
  }

  /** Draw the cursor on a separate layer, so that nothing else is redrawn. */
  point({ scene, cursor }, colours) {
    const ctx = clearedOver(this.over, this.canvas, cursor);
    if (!cursor) return;
    const ratio = ratioOf(this.canvas);
    const [x, y] = this.spot(scene, cursor).map((at) => Math.round(at) + 0.5);
    const { left, right, top, bottom } = this.#ends(scene);
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, right - left, bottom - top);
    ctx.clip();
    ctx.globalAlpha = 0.5;
    halo(ctx, ratio, colours, () => hair(ctx, x, y, 7 * ratio, Infinity));
    ctx.globalAlpha = 1;
    halo(ctx, ratio, colours, () => hair(ctx, x, y, 7 * ratio, 22 * ratio));
    ctx.restore();
  }

  /** Draw ticks in lengths at the median range along the map, and the scale bar. */
  #axes({ scene }, colours) {
    const { context: ctx, canvas } = this;
    const ratio = ratioOf(canvas);
    const view = this.view(scene);
    const box = this.#box();
    ctx.fillStyle = colours.stage;
    for (const [x, y, width, height] of [
      [0, 0, box.left, canvas.height],
      [box.right, 0, canvas.width - box.right, canvas.height],
      [0, 0, canvas.width, box.top],
      [0, box.bottom, canvas.width, canvas.height - box.bottom],
    ])
      ctx.fillRect(x, y, width, height);
    // The axes lie along the edges of the scan where these are in view.
    const ends = this.#ends(scene);
    const typical = withUnit(scene.typical, "m", 3);
    const [across, down] = [
      { name: "across", first: ends.left, last: ends.right, start: view.left, step: view.x },
      { name: "down", first: ends.top, last: ends.bottom, start: view.top, step: view.y },
    ].map((side, k) => this.#ticks(scene, side, scene.lengths[k], [55, 30][k] * ratio));
    across.label += ` at ${typical}`;
    mapAxes(ctx, ends, { across, down }, ratio, colours);
    this.axes = { ends, sides: [across, down] };
    // Beams diverge; axes and scale bar are valid at the stated median range.
    if (scene.columns > 1) {
      const perMetre = 1 / (view.x * scene.spacing.column);
      // Below the axis if there is room, otherwise on the map.
      const below = canvas.height - ends.bottom > 75 * ratio;
      const bottom = below ? canvas.height : Math.max(ends.bottom, 40 * ratio) + 6 * ratio;
      this.bar = scaleBar(ctx, perMetre, ratio, colours, ` at ${typical}`, {
        right: ends.right,
        bottom,
        most: 0.6 * (ends.right - ends.left),
      });
    }
  }

  /** Return the label of an axis, and its ticks: lengths from the first pixel. */
  #ticks(scene, { name, first, last, start, step }, { nodes, lengths }, apart) {
    const span = lengths.at(-1);
    const { factor, unit } = span < 2 ? { factor: 1e3, unit: "mm" } : { factor: 1, unit: "m" };
    const [low, high] = [first, last].map((at) => {
      const pixel = (start + at * step - 0.5) * scene.stride;
      return Math.min(Math.max(interpolated(nodes, lengths, pixel), 0), span) * factor;
    });
    const label = `${name} [${unit}]`;
    if (!(high > low)) return { label, ticks: [] };
    const { values, places } = ticks(low, high, Math.max(2, Math.floor((last - first) / apart)));
    return {
      label,
      ticks: values.map((value) => {
        const pixel = interpolated(lengths, nodes, value / factor);
        const at = (pixel / scene.stride + 0.5 - start) / step;
        return { at, value: value / factor, text: value.toFixed(places).replace("-", "−") };
      }),
    };
  }

  #marks(state, colours) {
    const { context: ctx, canvas } = this;
    const { scene } = state;
    const ratio = ratioOf(canvas);
    if (state.section) {
      const ends = state.section.map((pixel) => this.spot(scene, pixel));
      halo(ctx, 2 * ratio, colours, () => polyline(ctx, ends), true);
      ends.forEach((end) => dot(ctx, end, 4 * ratio, colours, true));
    }
    for (const kept of state.measurements) {
      const strong = kept === state.chosen;
      this.#shape(scene, { ...kept, strong, text: state.texts?.(kept) }, colours, ratio);
    }
    const spotOf = ({ row, column }) => this.spot(scene, [row, column]);
    annotated(ctx, state.annotations, spotOf, ratio, colours);
    const { tool: kind, picks, region } = state;
    if (picks.length || region) {
      this.#shape(scene, { kind, picks, region, strong: true }, colours, ratio);
    }
  }

  #shape(scene, kept, colours, ratio) {
    const { picks = [], region, strong } = kept;
    const spots = picks.map((pixel) => this.spot(scene, pixel));
    let corner;
    if (region) {
      const [a, b] = [region.slice(0, 2), region.slice(2)].map((end) => this.spot(scene, end));
      const [x, y] = [Math.min(a[0], b[0]), Math.min(a[1], b[1])];
      const path = () => {
        this.context.beginPath();
        this.context.rect(x, y, Math.abs(a[0] - b[0]), Math.abs(a[1] - b[1]));
      };
      halo(this.context, ratio * 1.5, colours, path, strong);
      corner = a;
    }
    chain(this.context, spots, kept, ratio, colours, spots[0] ?? corner);
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.#zoomed(Math.exp(-event.deltaY * 0.0016), event);
      },
      { passive: false },
    );
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, {
        x: event.clientX,
        y: event.clientY,
        moved: 0,
        at: event,
      });
    });
    canvas.addEventListener("pointermove", (event) => this.#moved(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => {
        const pointer = this.pointers.get(event.pointerId);
        this.pointers.delete(event.pointerId);
        if (!pointer || !this.scene || name === "pointercancel") return;
        const pixel = this.pixel(this.scene, event, true);
        if (this.on.drag("end", pointer.at, event, this)) return;
        if (pointer.moved < 6 && pixel && this.pixel(this.scene, event)) this.on.pick(pixel, event);
      });
    }
    canvas.addEventListener("dblclick", () => {
      this.home();
      this.on.hover(null);
      this.on.hover(undefined);
    });
  }

  #moved(event) {
    if (!this.scene) return;
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) {
      this.on.hover(this.pixel(this.scene, event));
      return;
    }
    const before = [pointer.x, pointer.y];
    pointer.moved += Math.abs(event.clientX - before[0]) + Math.abs(event.clientY - before[1]);
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers.values()].filter((one) => one !== pointer);
      const span = (x, y) => Math.hypot(x - other.x, y - other.y);
      // The midpoint of two fingers moves by half the motion of one.
      this.#panned((event.clientX - before[0]) / 2, (event.clientY - before[1]) / 2);
      this.#zoomed(span(event.clientX, event.clientY) / Math.max(span(...before), 1), {
        clientX: (event.clientX + other.x) / 2,
        clientY: (event.clientY + other.y) / 2,
      });
    } else if (!this.on.drag("move", pointer.at, event, this) && event.pointerType !== "touch") {
      this.#panned(event.clientX - before[0], event.clientY - before[1]);
    }
    pointer.x = event.clientX;
    pointer.y = event.clientY;
  }

  #panned(dx, dy) {
    const view = this.view(this.scene);
    const ratio = ratioOf(this.canvas);
    this.middle[0] -= dx * ratio * view.x;
    this.middle[1] -= dy * ratio * view.y;
    this.on.hover(undefined);
  }

  #zoomed(factor, event) {
    if (!this.scene) return;
    const at = spotOn(this.canvas, event);
    const before = this.view(this.scene);
    this.zoom = Math.min(Math.max(this.zoom * factor, 1), 200);
    const after = this.view(this.scene);
    this.middle[0] += before.left + at[0] * before.x - after.left - at[0] * after.x;
    this.middle[1] += before.top + at[1] * before.y - after.top - at[1] * after.y;
    this.on.hover(undefined);
  }
}

/** Begin a cross-shaped path around a position, between two distances from it. */
function hair(ctx, x, y, gap, end) {
  const { width, height } = ctx.canvas;
  ctx.beginPath();
  ctx.moveTo(Math.max(x - end, 0), y);
  ctx.lineTo(x - gap, y);
  ctx.moveTo(x + gap, y);
  ctx.lineTo(Math.min(x + end, width), y);
  ctx.moveTo(x, Math.max(y - end, 0));
  ctx.lineTo(x, y - gap);
  ctx.moveTo(x, y + gap);
  ctx.lineTo(x, Math.min(y + end, height));
}

/** Draw the color scale with its ticks. */
export function colourBar(canvas, gradientStops, [low, high], unit, colours, own = 0) {
  // An off-screen canvas states its pixel size itself.
  if (!own) fitted(canvas);
  const ctx = inkOf(canvas, { plot: true });
  const ratio = own || ratioOf(canvas);
  const { width, height } = canvas;
  ctx.clearRect(0, 0, width, height);
  const top = 3 * ratio;
  const thick = 10 * ratio;
  for (let x = 0; x < width; x += 1) {
    const at = 4 * Math.min(255, Math.floor((x / (width - 1)) * 255.99));
    ctx.fillStyle = `rgb(${gradientStops[at]},${gradientStops[at + 1]},${gradientStops[at + 2]})`;
    ctx.fillRect(x, top, 1, thick);
  }
  ctx.font = `${12 * ratio}px ${colours.font}`;
  ctx.fillStyle = colours.soft;
  ctx.textBaseline = "top";
  const marks = ticks(low, high, Math.max(2, Math.floor(width / ratio / 75)));
  let end = -Infinity;
  for (const value of marks.values) {
    const x = ((value - low) / (high - low)) * (width - 1);
    const text = `${value.toFixed(marks.places).replace("-", "−")}`;
    const size = ctx.measureText(text).width;
    const left = Math.min(Math.max(x - size / 2, 0), width - size);
    if (left < end + 6 * ratio) continue;
    ctx.fillRect(x, top + thick, ratio, 3 * ratio);
    ctx.fillText(text, left, top + thick + 5 * ratio);
    end = left + size;
  }
  canvas.setAttribute(
    "aria-label",
    `Colors from ${withUnit(low, "1")} to ${withUnit(high, "1")} ${unit}`,
  );
}
