// The map of one layer: zoom, pick, lines and regions on it.

import { ticks, withUnit } from "./text.js";

/** Fit a canvas to its place on the screen; returns whether it changed. */
export function fitted(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}

/** Draws a map and tells what is pointed at. */
export class MapView {
  constructor(canvas, { hover, pick, drag }) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { willReadFrequently: false });
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

  /** Return column and row at the top left, and columns and rows a canvas pixel. */
  view(scene) {
    const { width, height } = this.canvas;
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
      left: this.middle[0] - half[0],
      top: this.middle[1] - half[1],
      x: step[0],
      y: step[1],
    };
  }

  /** Return the pixel of the scan at a place on the screen, null beside it. */
  pixel(scene, event, kept = false) {
    const box = this.canvas.getBoundingClientRect();
    const view = this.view(scene);
    const ratio = this.canvas.width / box.width;
    let column = Math.floor(view.left + (event.clientX - box.left) * ratio * view.x);
    let row = Math.floor(view.top + (event.clientY - box.top) * ratio * view.y);
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

  /** Return where the middle of a pixel is on the canvas. */
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
  }

  #marks(state, colours) {
    const { context: ctx, canvas } = this;
    const { scene } = state;
    const ratio = canvas.width / Math.max(canvas.clientWidth, 1);
    ctx.lineWidth = ratio;
    if (state.cursor) {
      const [x, y] = this.spot(scene, state.cursor).map((at) => Math.round(at) + 0.5);
      halo(
        ctx,
        ratio,
        colours,
        () => {
          ctx.beginPath();
          ctx.moveTo(0, y);
          ctx.lineTo(x - 7 * ratio, y);
          ctx.moveTo(x + 7 * ratio, y);
          ctx.lineTo(canvas.width, y);
          ctx.moveTo(x, 0);
          ctx.lineTo(x, y - 7 * ratio);
          ctx.moveTo(x, y + 7 * ratio);
          ctx.lineTo(x, canvas.height);
        },
        0.55,
      );
    }
    if (state.section) {
      const ends = state.section.map((pixel) => this.spot(scene, pixel));
      halo(ctx, 2 * ratio, { ...colours, mark: colours.accent }, () => polyline(ctx, ends));
      ends.forEach((end) => dot(ctx, end, 4 * ratio, colours.accent));
    }
    for (const kept of state.measurements)
      this.#shape(scene, kept, colours, ratio, kept === state.chosen);
    if (state.picks.length || state.region)
      this.#shape(
        scene,
        { kind: state.tool, picks: state.picks, region: state.region },
        colours,
        ratio,
        true,
      );
  }

  #shape(scene, { kind, picks = [], region, number }, colours, ratio, strong) {
    const { context: ctx } = this;
    const colour = strong ? colours.accent : colours.mark;
    if (region) {
      const [a, b] = [this.spot(scene, region.slice(0, 2)), this.spot(scene, region.slice(2))];
      halo(ctx, ratio * 1.5, { ...colours, mark: colour }, () => {
        ctx.beginPath();
        ctx.rect(
          Math.min(a[0], b[0]),
          Math.min(a[1], b[1]),
          Math.abs(a[0] - b[0]),
          Math.abs(a[1] - b[1]),
        );
      });
    }
    const spots = picks.map((pixel) => this.spot(scene, pixel));
    if (spots.length > 1 && kind !== "circle") {
      halo(ctx, ratio * 1.5, { ...colours, mark: colour }, () =>
        polyline(ctx, kind === "area" ? [...spots, spots[0]] : spots),
      );
    }
    spots.forEach((spot) => dot(ctx, spot, 4.5 * ratio, colour));
    const label = number && (spots[0] ?? (region && this.spot(scene, region.slice(0, 2))));
    if (label)
      tag(ctx, String(number), [label[0] + 8 * ratio, label[1] - 8 * ratio], ratio, colours);
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
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const span = (x, y) => Math.hypot(x - other.x, y - other.y);
      this.#zoomed(span(event.clientX, event.clientY) / Math.max(span(...before), 1), {
        clientX: (event.clientX + other.x) / 2,
        clientY: (event.clientY + other.y) / 2,
      });
    } else if (!this.on.drag("move", pointer.at, event, this)) {
      const view = this.view(this.scene);
      const ratio = this.canvas.width / this.canvas.clientWidth;
      this.middle[0] -= (event.clientX - before[0]) * ratio * view.x;
      this.middle[1] -= (event.clientY - before[1]) * ratio * view.y;
      this.on.hover(undefined);
    }
    pointer.x = event.clientX;
    pointer.y = event.clientY;
  }

  #zoomed(factor, event) {
    if (!this.scene) return;
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    const at = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    const before = this.view(this.scene);
    this.zoom = Math.min(Math.max(this.zoom * factor, 1), 200);
    const after = this.view(this.scene);
    this.middle[0] += before.left + at[0] * before.x - after.left - at[0] * after.x;
    this.middle[1] += before.top + at[1] * before.y - after.top - at[1] * after.y;
    this.on.hover(undefined);
  }
}

function polyline(ctx, spots) {
  ctx.beginPath();
  spots.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
}

/** Stroke a path twice, so that it is seen on any colour. */
export function halo(ctx, width, colours, path, alpha = 0.95) {
  ctx.save();
  ctx.globalAlpha = alpha;
  ctx.lineJoin = "round";
  path();
  ctx.lineWidth = width * 3;
  ctx.strokeStyle = colours.under;
  ctx.stroke();
  path();
  ctx.lineWidth = width;
  ctx.strokeStyle = colours.mark;
  ctx.stroke();
  ctx.restore();
}

/** Draw a mark on a picked pixel. */
export function dot(ctx, [x, y], size, colour) {
  ctx.save();
  ctx.beginPath();
  ctx.arc(x, y, size, 0, 7);
  ctx.fillStyle = "#fff";
  ctx.fill();
  ctx.beginPath();
  ctx.arc(x, y, size * 0.68, 0, 7);
  ctx.fillStyle = colour;
  ctx.fill();
  ctx.restore();
}

/** Draw a short text on a plate. */
export function tag(ctx, text, [x, y], ratio, colours) {
  ctx.save();
  ctx.font = `600 ${12 * ratio}px ${colours.font}`;
  const width = ctx.measureText(text).width + 9 * ratio;
  ctx.fillStyle = colours.plate;
  ctx.beginPath();
  ctx.roundRect(x, y - 9 * ratio, width, 18 * ratio, 5 * ratio);
  ctx.fill();
  ctx.fillStyle = colours.ink;
  ctx.textBaseline = "middle";
  ctx.fillText(text, x + 4.5 * ratio, y + ratio);
  ctx.restore();
}

/** Draw the scale of colours with its ticks. */
export function colourBar(canvas, gradientStops, [low, high], unit, colours, own = 0) {
  // A canvas that is nowhere on the screen states the size of its pixels itself.
  if (!own) fitted(canvas);
  const ctx = canvas.getContext("2d");
  const ratio = own || canvas.width / Math.max(canvas.clientWidth, 1);
  const { width, height } = canvas;
  ctx.clearRect(0, 0, width, height);
  const top = 3 * ratio;
  const thick = 10 * ratio;
  for (let x = 0; x < width; x += 1) {
    const at = 4 * Math.min(255, Math.floor((x / (width - 1)) * 255.99));
    ctx.fillStyle = `rgb(${gradientStops[at]},${gradientStops[at + 1]},${gradientStops[at + 2]})`;
    ctx.fillRect(x, top, 1, thick);
  }
  ctx.font = `${11 * ratio}px ${colours.font}`;
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
    `Colours from ${withUnit(low, "1")} to ${withUnit(high, "1")} ${unit}`,
  );
}
