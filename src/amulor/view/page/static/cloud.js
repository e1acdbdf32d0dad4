// Points in space, seen by a camera that goes around them.

import { Camera, projected } from "./camera.js";
import { dot, halo, tag } from "./map.js";
import { ticks, withUnit } from "./text.js";

/** Points that a picture still moves with, and at rest. */
const MOVING = 250000;
const RESTING = 2000000;

export class CloudView {
  constructor(canvas, { hover, pick, changed }) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.camera = new Camera();
    this.pointers = new Map();
    this.on = { hover, pick, changed };
    this.busy = 0;
    this.#listen();
  }

  /** Look at a scene as a whole. */
  home(scene, shape = scene.main) {
    const places = [];
    const step = Math.max(1, Math.floor(Math.sqrt((scene.wide * scene.high) / 3000)));
    for (let row = 0; row < scene.high; row += step) {
      for (let column = 0; column < scene.wide; column += step) {
        const pixel = [row * scene.stride, column * scene.stride];
        const point = scene.point(...pixel, shape);
        // Without a target, raw ranges are those of the water alone, far before it.
        if (point && Number.isFinite(scene.value(scene.main, ...pixel))) places.push(point);
      }
    }
    if (!places.length)
      places.push(
        ...[
          [0, 0],
          [scene.rows - 1, scene.columns - 1],
        ].map((pixel) => scene.beams.point(...pixel, scene.typical)),
      );
    const ends = [0, 1, 2].map((k) => {
      const sorted = places.map((place) => place[k]).sort((a, b) => a - b);
      return [
        sorted[Math.floor(0.01 * sorted.length)],
        sorted[Math.floor(0.99 * (sorted.length - 1))],
      ];
    });
    const size = Math.hypot(...ends.map(([low, high]) => high - low)) || 0.1;
    this.camera.home({ target: ends.map(([low, high]) => (low + high) / 2), size });
    // A few points that stand far off make nothing small.
    this.places = places.filter((place) =>
      place.every((part, k) => part >= ends[k][0] && part <= ends[k][1]),
    );
    this.#fitted();
  }

  /** Keep another shape of the scene in view, from the same side and as near. */
  follow(scene, shape) {
    const { turn, rise, target, start, distance } = this.camera;
    const before = this.fitting;
    const moved = this.moved();
    this.home(scene, shape);
    Object.assign(this.camera, { turn, rise });
    this.#fitted();
    this.camera.target = this.camera.target.map((part, k) => part + target[k] - start.target[k]);
    this.camera.distance *= distance / before;
    if (!moved) this.placed = this.#pose();
  }

  /** Return whether someone has turned, moved or zoomed since the scene was put in view. */
  moved() {
    return this.#pose() !== this.placed;
  }

  #pose() {
    const { turn, rise, distance, target } = this.camera;
    return [turn, rise, distance, ...target].join();
  }

  /** Look along the beams. */
  front() {
    this.camera.straight();
    this.#fitted();
    this.placed = "";
  }

  #fitted() {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientHeight) this.camera.fit(this.places ?? [], clientWidth / clientHeight);
    this.fitting = this.camera.distance;
    this.placed = this.#pose();
  }

  #parts(state, stride) {
    const { scene } = state;
    const { width, height } = this.canvas;
    const { camera } = this;
    const parts = scene.uniforms(state.layerName, state.limits, state.look);
    const across = Math.ceil(scene.wide / stride);
    const matrix = camera.matrix(width / height);
    // As large on the screen as the pixels are apart, so that surfaces close.
    const gap = Math.max(scene.spacing.row, scene.spacing.column) * stride * 1.32;
    const focal = camera.orthographic
      ? height / camera.span()
      : height / 2 / Math.tan(Camera.ANGLE / 2);
    Object.assign(parts.set, {
      uProject: ["Matrix4fv", false, matrix],
      uStride: ["1i", stride],
      uAcross: ["1i", across],
      uDot: ["1f", gap * focal],
      uShrinks: ["1i", camera.orthographic ? 0 : 1],
      uAveraged: ["1i", state.look.averaged ? 1 : 0],
    });
    return {
      ...parts,
      matrix,
      ground: state.look.ground,
      points: across * Math.ceil(scene.high / stride),
    };
  }

  #stride(scene, most) {
    return Math.max(1, Math.ceil(Math.sqrt((scene.wide * scene.high) / most)));
  }

  draw(state, colours) {
    const { scene, renderer } = state;
    this.state = state;
    const stride = this.#stride(scene, this.busy ? MOVING : RESTING);
    const parts = this.#parts(state, stride);
    renderer.drawCloud(this.context, parts);
    this.matrix = parts.matrix;
    this.#marks(state, colours);
  }

  /** Return the pixel whose point is seen at a place, null beside all of them. */
  seen(event) {
    const { state } = this;
    if (!state) return null;
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    const x = Math.round((event.clientX - box.left) * ratio);
    const y = Math.round((event.clientY - box.top) * ratio);
    const { scene } = state;
    const parts = this.#parts(state, this.#stride(scene, RESTING));
    const id = state.renderer.drawCloud(this.context, { ...parts, pick: { x, y } });
    if (id < 0) return null;
    return [Math.floor(id / scene.wide) * scene.stride, (id % scene.wide) * scene.stride];
  }

  #spot(point) {
    return point && projected(this.matrix, point, this.canvas.width, this.canvas.height);
  }

  #marks(state, colours) {
    const { context: ctx, canvas } = this;
    const { scene } = state;
    const ratio = canvas.width / Math.max(canvas.clientWidth, 1);
    const shape = shapeOf(state);
    const spotOf = (pixel) => this.#spot(scene.point(...pixel, shape));
    const chains = [
      ...state.measurements.map((kept) => ({ ...kept, strong: kept === state.chosen })),
      { kind: state.tool, picks: state.picks, strong: true },
    ];
    for (const { kind, picks = [], strong, number } of chains) {
      const spots = picks.map(spotOf).filter(Boolean);
      const colour = strong ? colours.accent : colours.mark;
      if (spots.length > 1 && kind !== "circle") {
        halo(ctx, 1.5 * ratio, { ...colours, mark: colour }, () => {
          ctx.beginPath();
          const all = kind === "area" ? [...spots, spots[0]] : spots;
          all.forEach(([x, y], k) => (k ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
        });
      }
      spots.forEach((spot) => dot(ctx, spot, 4.5 * ratio, colour));
      if (number && spots[0])
        tag(
          ctx,
          String(number),
          [spots[0][0] + 8 * ratio, spots[0][1] - 8 * ratio],
          ratio,
          colours,
        );
    }
    const at = state.cursor && spotOf(state.cursor);
    if (at) dot(ctx, at, 5 * ratio, colours.cursor);
    this.#axes(ctx, ratio, colours);
    if (this.camera.orthographic) this.#bar(ctx, ratio, colours);
  }

  #axes(ctx, ratio, colours) {
    const { right, up, forward } = this.camera.frame();
    const origin = [62 * ratio, this.canvas.height - 42 * ratio];
    const names = [
      ["right", [1, 0, 0], "#D55E00"],
      ["down", [0, 1, 0], "#009E73"],
      ["forward", [0, 0, 1], "#0072B2"],
    ];
    ctx.save();
    ctx.font = `${10.5 * ratio}px ${colours.font}`;
    ctx.textBaseline = "middle";
    ctx.lineWidth = 2 * ratio;
    names
      .map(([name, axis, colour]) => ({
        name,
        colour,
        x: dotted(axis, right),
        y: -dotted(axis, up),
        z: dotted(axis, forward),
      }))
      .sort((a, b) => b.z - a.z)
      .forEach(({ name, colour, x, y }) => {
        const end = [origin[0] + x * 20 * ratio, origin[1] + y * 20 * ratio];
        ctx.strokeStyle = colour;
        ctx.beginPath();
        ctx.moveTo(...origin);
        ctx.lineTo(...end);
        ctx.stroke();
        if (Math.hypot(x, y) < 0.35) return;
        ctx.fillStyle = colours.soft;
        ctx.textAlign = x < -0.3 ? "right" : x > 0.3 ? "left" : "center";
        ctx.fillText(name, origin[0] + x * 25 * ratio, origin[1] + y * 27 * ratio);
      });
    ctx.restore();
  }

  #bar(ctx, ratio, colours) {
    const perMetre = this.canvas.height / this.camera.span();
    const { step } = ticks(0, (150 * ratio) / perMetre, 1.2);
    const length = step * perMetre;
    const right = this.canvas.width - 18 * ratio;
    const low = this.canvas.height - 20 * ratio;
    ctx.save();
    ctx.strokeStyle = colours.ink;
    ctx.lineWidth = 2 * ratio;
    ctx.beginPath();
    ctx.moveTo(right - length, low - 5 * ratio);
    ctx.lineTo(right - length, low);
    ctx.lineTo(right, low);
    ctx.lineTo(right, low - 5 * ratio);
    ctx.stroke();
    ctx.fillStyle = colours.ink;
    ctx.font = `${12 * ratio}px ${colours.font}`;
    ctx.textAlign = "center";
    ctx.fillText(withUnit(step, "m", 2), right - length / 2, low - 8 * ratio);
    ctx.restore();
    this.barMetres = step;
    this.barPixels = length;
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.camera.zoom(Math.exp(event.deltaY * 0.0013));
        this.#turned();
      },
      { passive: false },
    );
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, moved: 0 });
    });
    canvas.addEventListener("pointermove", (event) => this.#moved(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => {
        const pointer = this.pointers.get(event.pointerId);
        this.pointers.delete(event.pointerId);
        if (pointer && pointer.moved < 6 && name === "pointerup") {
          const pixel = this.seen(event);
          if (pixel) this.on.pick(pixel, event);
        }
      });
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => {
      if (this.state) this.home(this.state.scene, shapeOf(this.state));
      this.#turned();
    });
  }

  #moved(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) {
      if (this.state && this.state.scene.wide * this.state.scene.high <= MOVING)
        this.on.hover(this.seen(event));
      return;
    }
    const dx = event.clientX - pointer.x;
    const dy = event.clientY - pointer.y;
    pointer.moved += Math.abs(dx) + Math.abs(dy);
    const tall = this.canvas.clientHeight;
    if (this.pointers.size === 2) {
      const other = [...this.pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
      const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
      this.camera.zoom(before / Math.max(after, 1));
      this.camera.pan(dx / 2 / tall, dy / 2 / tall);
    } else if (event.shiftKey || event.buttons & 6) {
      this.camera.pan(dx / tall, dy / tall);
    } else {
      this.camera.orbit((dx / tall) * 3.2, (dy / tall) * 3.2);
    }
    pointer.x = event.clientX;
    pointer.y = event.clientY;
    this.#turned();
  }

  #turned() {
    this.busy += 1;
    const now = this.busy;
    this.on.changed();
    setTimeout(() => {
      if (this.busy === now) {
        this.busy = 0;
        this.on.changed();
      }
    }, 180);
  }
}

/** Return the map that the points are made of. */
function shapeOf({ scene, look }) {
  return look.raw && scene.byName.has("range_before") ? "range_before" : scene.main;
}

function dotted(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
