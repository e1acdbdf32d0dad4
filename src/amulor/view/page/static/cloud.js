// Surface or points of a scan in space, viewed by an orbiting camera.

import { Camera, extent, projected } from "./camera.js";
import { inkOf, over, ratioOf, spotOn } from "./dom.js";
import { dots, nodesIn, triangles } from "./geometry.js";
import { clearedOver } from "./map.js";
import { annotated, axes, chain, chains, dot, halo, polyline, scaleBar } from "./marks.js";
import { Motion, Pace, turnable } from "./turning.js";

/** Number of pixels drawn at rest, and smallest number while the view moves. */
const RESTING = 2000000;
const FEWEST = 20000;
/** Largest number of pixels at which the point under the pointer is searched. */
const HOVERED = 250000;
const AXES = [
  ["right", [1, 0, 0]],
  ["down", [0, 1, 0]],
  ["forward", [0, 0, 1]],
];

/** View of a scan's surface or points, which reports the pixel under the pointer. */
export class CloudView {
  constructor(canvas, { hover, pick, changed, clip }) {
    this.canvas = canvas;
    this.context = inkOf(canvas, { opaque: true });
    this.over = inkOf(over(canvas));
    this.camera = new Camera();
    /** Points that must be in view. */
    this.places = /** @type {import("./camera.js").Point[]} */ ([]);
    /** Camera distance and pose when the points were put in view. */
    this.fitting = 1;
    this.placed = "";
    /** Matrix of the last drawing. */
    this.matrix = /** @type {any} */ (null);
    this.motion = new Motion(changed);
    /** Number of pixels drawn while the view moves. */
    this.pace = new Pace(60000, { fewest: FEWEST, most: RESTING });
    this.points = false;
    this.clip = clip;
    const spotOf = (point) => this.#spot(point);
    turnable(canvas, this.camera, {
      moved: () => this.motion.moved(),
      hover: (event) => {
        if (this.state && this.state.scene.wide * this.state.scene.high <= HOVERED) {
          hover(this.seen(event));
        }
      },
      grab: (event) => this.clip.grab(canvas, spotOf, event),
      pick: (event) => {
        const pixel = this.seen(event);
        if (pixel) pick(pixel);
      },
      home: () => this.state && this.home(this.state.scene, shapeOf(this.state)),
    });
  }

  /** Return the height of the view for a width, in the proportions of the screen. */
  high(_scene, width) {
    return (width * this.canvas.clientHeight) / Math.max(this.canvas.clientWidth, 1);
  }

  /** Return an even part of the points of a scene. */
  spread(scene, shape = scene.main) {
    const places = /** @type {import("./camera.js").Point[]} */ ([]);
    const step = Math.max(1, Math.floor(Math.sqrt((scene.wide * scene.high) / 3000)));
    for (let row = 0; row < scene.high; row += step) {
      for (let column = 0; column < scene.wide; column += step) {
        const pixel = [row * scene.stride, column * scene.stride];
        const point = scene.point(...pixel, shape);
        // Without a target, raw ranges are those of the water alone, far before it.
        if (point && Number.isFinite(scene.value(scene.main, ...pixel))) places.push(point);
      }
    }
    return places;
  }

  /** Show a whole scene. */
  home(scene, shape = scene.main) {
    const places = this.spread(scene, shape);
    if (!places.length) {
      for (const pixel of [
        [0, 0],
        [scene.rows - 1, scene.columns - 1],
      ]) {
        places.push(scene.beams.point(...pixel, scene.typical));
      }
    }
    const { target, size, inside } = extent(places);
    this.camera.home({ target, size });
    this.places = inside;
    this.#fitted();
  }

  /** Show a changed scene from the same direction and distance. */
  follow(scene, shape) {
    const { turn, rise, target, start, distance } = this.camera;
    const before = this.fitting;
    const moved = this.moved();
    this.home(scene, shape);
    Object.assign(this.camera, { turn, rise });
    this.#fitted();
    for (const k of [0, 1, 2]) this.camera.target[k] += target[k] - start.target[k];
    this.camera.distance *= distance / before;
    if (!moved) this.placed = this.#pose();
  }

  /** Return whether the user has changed the view since the scene was put in view. */
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

  /** Put the scene in view again after a change of size, unless the user has moved the view. */
  refit() {
    if (!this.moved()) this.#fitted();
  }

  #fitted() {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientHeight) this.camera.fit(this.places, clientWidth / clientHeight);
    this.fitting = this.camera.distance;
    this.placed = this.#pose();
  }

  /** Return what the renderer draws: nodes of the grid, and triangles and points of them. */
  #parts(state, most) {
    const { scene } = state;
    const { width, height } = this.canvas;
    const { camera } = this;
    const { set, ...maps } = scene.uniforms(state.layerName, state.limits, state.look);
    const step = strideOf(scene, RESTING);
    const stride = step * Math.max(1, Math.round(strideOf(scene, most) / step));
    const across = nodesIn(scene.wide, step);
    const averaged = state.look.averaged ? 1 : 0;
    const range = shapeOf(state);
    const shape = `${scene.version} ${range}`;
    const colours = ["uLimits", "uKind", "uMissing", "uLight", "uRelief"].map((name) => set[name]);
    const matrix = camera.matrix(width / height);
    // Dots as large as the spacing of the pixels, so that surfaces have no gaps.
    const gap = Math.max(scene.spacing.row, scene.spacing.column) * stride * 1.32;
    const focal = camera.orthographic
      ? height / camera.span()
      : height / 2 / Math.tan(Camera.ANGLE / 2);
    return {
      matrix,
      across,
      step,
      shape,
      ground: state.look.ground,
      nodes: {
        ...maps,
        set: {
          ...set,
          uStep: ["1i", step],
          uAcross: ["1i", across],
          uAveraged: ["1i", averaged],
        },
        key: [shape, maps.layer, averaged, colours].join(),
        count: across * nodesIn(scene.high, step),
      },
      ...drawnOf(scene, scene.maps.get(range), step, stride),
      set: {
        uProject: ["Matrix4fv", false, matrix],
        uDot: ["1f", gap * focal],
        uShrinks: ["1i", camera.orthographic ? 0 : 1],
        uClipped: set.uClipped,
        uLow: set.uLow,
        uHigh: set.uHigh,
      },
    };
  }

  draw(state, colours) {
    const { renderer } = state;
    this.state = state;
    const { busy } = this.motion;
    const parts = this.#parts(state, busy ? this.pace.count : RESTING);
    renderer.drawCloud(this.context, { ...parts, parts: this.points ? parts.all : parts.surface });
    if (busy) this.pace.measure(renderer.gl);
    this.matrix = parts.matrix;
    this.#marks(state, colours);
    this.point(state, colours);
  }

  /** Return the pixel whose point is at a screen position; null if there is none. */
  seen(event) {
    const { state } = this;
    if (!state) return null;
    const [x, y] = spotOn(this.canvas, event).map(Math.round);
    const { scene } = state;
    const { across, step, ...rest } = this.#parts(state, RESTING);
    const id = state.renderer.drawCloud(this.context, { ...rest, parts: rest.all, pick: { x, y } });
    if (id < 0) return null;
    return [
      Math.min(Math.floor(id / across) * step, scene.high - 1) * scene.stride,
      Math.min((id % across) * step, scene.wide - 1) * scene.stride,
    ];
  }

  #spot(point) {
    return point && projected(this.matrix, point, this.canvas.width, this.canvas.height);
  }

  /** Draw the cursor on a separate layer, which a moving view does without. */
  point(state, colours) {
    const { scene, cursor } = state;
    const at = cursor && this.matrix && this.#spot(scene.point(...cursor, shapeOf(state)));
    const { busy } = this.motion;
    const ctx = clearedOver(this.over, this.canvas, at && !busy);
    if (at) dot(busy ? this.context : ctx, at, 5 * ratioOf(this.canvas), colours, true);
  }

  /** Draw the rectangles of measurements on the surface, with gaps where it has gaps. */
  #rectangles(state, colours, ratio) {
    const { context: ctx } = this;
    const { scene, look, measurements, chosen, region } = state;
    const shape = shapeOf(state);
    const { values, smooth } = scene.maps.get(shape);
    const drawn = look.averaged && smooth ? smooth : values;
    const place = (pixel) => {
      const [row, column] = pixel;
      const range =
        drawn[Math.floor(row / scene.stride) * scene.wide + Math.floor(column / scene.stride)];
      return Number.isFinite(range) ? this.#spot(scene.beams.point(row, column, range)) : null;
    };
    for (const kept of [...measurements, { region }]) {
      if (!kept.region) continue;
      const strong = kept === chosen || !kept.number;
      const spots = edgesOf(kept.region, scene.stride).map(place).filter(Boolean);
      halo(ctx, 1.5 * ratio, colours, () => polyline(ctx, spots), strong);
      const axis = (kept.found?.axis ?? []).map((point) => this.#spot(point)).filter(Boolean);
      if (axis.length === 2) halo(ctx, 1.5 * ratio, colours, () => polyline(ctx, axis), strong);
      if (!kept.number || !spots.length) continue;
      const text = state.texts?.(kept);
      chain(ctx, [], { ...kept, strong, text }, ratio, colours, spots[0]);
    }
  }

  #marks(state, colours) {
    const { context: ctx, camera } = this;
    const ratio = ratioOf(this.canvas);
    const shape = shapeOf(state);
    const spotOf = (pixel) => this.#spot(state.scene.point(...pixel, shape));
    this.clip.draw(ctx, (point) => this.#spot(point), ratio, colours);
    this.#rectangles(state, colours, ratio);
    chains(ctx, state, spotOf, ratio, colours);
    const noted = ({ row, column }) => spotOf([row, column]);
    annotated(ctx, state.annotations, noted, ratio, colours);
    axes(ctx, camera, AXES, ratio, colours);
    if (camera.orthographic)
      this.bar = scaleBar(ctx, ctx.canvas.height / camera.span(), ratio, colours);
  }
}

/** Return what is drawn of a range map: all pixels as points, or the surface and the points
that no triangle of it has. Nodes are apart by a step, points and cells by a stride. */
function drawnOf({ wide }, { values, marks }, step, stride) {
  const part = (name, mode, numbers) => ({ name: `${name} ${stride}`, mode, numbers });
  return {
    all: [part("all", "points", () => dots(values, null, wide, step, stride))],
    surface: [
      part("surface", "triangles", () => triangles(values, marks, wide, step, stride)),
      part("alone", "points", () => dots(values, marks, wide, step, stride)),
    ],
  };
}

/** Return the step in rows and columns at which about a given number of pixels is drawn. */
function strideOf(scene, most) {
  return Math.max(1, Math.ceil(Math.sqrt((scene.wide * scene.high) / most)));
}

/** Return the pixels along the edges of a rectangle, thinned evenly. */
function edgesOf([top, left, bottom, right], stride) {
  const corners = [
    [top, left],
    [top, right],
    [bottom, right],
    [bottom, left],
    [top, left],
  ];
  return corners.slice(1).flatMap(([row, column], k) => {
    const [from, start] = corners[k];
    const long = Math.max(Math.abs(row - from), Math.abs(column - start)) / stride;
    const count = Math.max(Math.min(long, 40), 1);
    return Array.from({ length: Math.ceil(count) + 1 }, (_, i) => {
      const share = i / Math.ceil(count);
      return [
        Math.round(from + share * (row - from)),
        Math.round(start + share * (column - start)),
      ];
    });
  });
}

/** Return the range map from which the points are computed. */
function shapeOf({ scene, look }) {
  return look.raw && scene.byName.has("range_before") ? "range_before" : scene.main;
}
