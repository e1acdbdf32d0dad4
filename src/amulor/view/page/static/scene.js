// One channel of a recording: maps, beams, and values of pixels.

import { flagRanks, flagTable, MAP_OF, MAPS, table } from "./colour.js";
import { Beams, surfaceMarks } from "./geometry.js";

/** Lengths [m] and probabilities [1] below this are rounding errors. */
export const ROUNDING = 1e-9;

/** @typedef {import("./colour.js").Layer} Layer */
/** @typedef {import("./colour.js").Flag} Flag */

/** Maps of a channel, stored here and on the graphics card. */
export class Scene {
  // Description of the channel, from the server or from the page.
  channel = "";
  rows = 0;
  columns = 0;
  stride = 1;
  /** @type {Layer[]} */
  layers = [];
  /** @type {Flag[]} */
  flags = [];
  /** @type {{rows: number[], columns: number[]}} */
  nodes = { rows: [], columns: [] };
  // Values derived from the description.
  wide = 0;
  high = 0;
  main = "range";
  reach = 1;
  typical = 1;
  aspect = 1;
  spacing = { row: 1e-3, column: 1e-3 };
  beams = new Beams(this.nodes, new Float32Array());
  /** Lengths along the middle row and the middle column at the median range [m]. */
  lengths = [0, 1].map(() => ({ nodes: [0], lengths: [0] }));
  /** @type {Map<string, Layer>} */
  byName = new Map();

  constructor(source, renderer) {
    this.source = source;
    this.renderer = renderer;
    this.maps = new Map();
    this.loading = new Map();
    /** Number of changes of the maps on the graphics card. */
    this.version = 0;
    /** Rows received since the last recomputation. */
    this.fresh = new Set();
    for (const name of MAPS) renderer.keep(`table ${name}`, 256, 1, table(name));
  }

  /** Return the description of a map. */
  about(name) {
    const layer = this.byName.get(name);
    if (!layer) throw new Error(`There is no map "${name}" here.`);
    return layer;
  }

  /** Load the description; maps are loaded when needed. */
  async open(channel) {
    const before = [this.channel, this.wide, this.high].join();
    Object.assign(this, await this.source.scene(channel));
    this.loading.clear();
    this.fresh.clear();
    this.wide = Math.ceil(this.columns / this.stride);
    this.high = Math.ceil(this.rows / this.stride);
    this.byName = new Map(this.layers.map((layer) => [layer.name, layer]));
    // For a running scan, the old maps stay until the new ones are loaded.
    if (before !== [this.channel, this.wide, this.high].join()) this.maps.clear();
    const main = this.byName.has("range") ? "range" : "range_before";
    this.renderer.keep("table flags", 256, 1, flagTable(this.flags, "#2c7f62"));
    const [nodes] = await Promise.all([
      this.source.layer(this.channel, "beams", false),
      this.load(main),
    ]);
    this.main = main;
    for (const name of this.maps.keys()) if (!this.byName.has(name)) this.maps.delete(name);
    this.#place(nodes);
    if (this.byName.has("range") && this.byName.has("range_before")) {
      this.byName.set("shift", {
        name: "shift",
        label: "Moved by water",
        unit: "m",
        kind: "signed",
        before: false,
        derived: true,
      });
    }
    return this;
  }

  #place(values) {
    this.version += 1;
    this.beams = new Beams(this.nodes, values);
    const { rows, columns } = this.nodes;
    const base = new Float32Array(4 * rows.length * columns.length);
    const aim = new Float32Array(base.length);
    for (let i = 0; i < rows.length * columns.length; i += 1) {
      base.set(values.subarray(8 * i, 8 * i + 3), 4 * i);
      aim.set(values.subarray(8 * i + 3, 8 * i + 6), 4 * i);
    }
    this.renderer.keep("base", columns.length, rows.length, base, 4);
    this.renderer.keep("aim", columns.length, rows.length, aim, 4);
    this.renderer.keep("rows", this.high, 1, shares(rows, this.high, this.stride), 2);
    this.renderer.keep("columns", this.wide, 1, shares(columns, this.wide, this.stride), 2);
    const centre = [Math.floor(this.rows / 2), Math.floor(this.columns / 2)];
    const step = (row, column) => {
      const one = this.beams.at(centre[0], centre[1]);
      const other = this.beams.at(row, column);
      const far = this.typical || 1;
      return Math.hypot(
        ...[0, 1, 2].map((k) => other[k] - one[k] + far * (other[3 + k] - one[3 + k])),
      );
    };
    const finite = sampled(this.maps.get(this.main).values, 4000)
      .filter(Number.isFinite)
      .sort((a, b) => a - b);
    this.typical = finite.length ? finite[finite.length >> 1] : 1;
    const downs =
      this.rows > 1 ? step(Math.min(centre[0] + this.stride, this.rows - 1), centre[1]) : 0;
    const across =
      this.columns > 1 ? step(centre[0], Math.min(centre[1] + this.stride, this.columns - 1)) : 0;
    this.spacing = { row: downs || across || 1e-3, column: across || downs || 1e-3 };
    const aspect = this.spacing.row / this.spacing.column;
    this.aspect = Math.min(Math.max(aspect, 0.05), 20);
    const [row, column] = centre;
    this.lengths = [
      { nodes: columns, lengths: this.beams.alongRow(row, this.typical) },
      { nodes: rows, lengths: this.beams.alongColumn(column, this.typical) },
    ];
  }

  /** Return a map; load it if necessary. */
  load(name) {
    if (!this.loading.has(name)) this.loading.set(name, this.#loaded(name));
    return this.loading.get(name);
  }

  async #loaded(name) {
    const layer = this.about(name);
    let values;
    if (layer.derived) {
      const [after, before] = await Promise.all([this.load("range"), this.load("range_before")]);
      values = after.values.map((value, at) => before.values[at] - value);
    } else {
      values = await this.source.layer(this.channel, name, layer.kind === "flags");
      if (values.length !== this.wide * this.high)
        throw new Error(
          `The map ${name} has ${values.length} numbers instead of ${this.wide * this.high}.`,
        );
    }
    const map = { layer, values };
    this.maps.set(name, map);
    this.upload(name);
    return map;
  }

  /** Copy a whole map to the graphics card. */
  upload(name) {
    this.version += 1;
    const { layer, values } = this.maps.get(name);
    const shown = layer.kind === "flags" ? flagRanks(values, this.flags) : values;
    this.renderer.keep(`map ${name}`, this.wide, this.high, shown);
    if (name === "range" || name === "range_before") this.smooth(name);
    if (layer.name.startsWith("steps")) this.smooth(name.replace("steps", "range"));
    if (layer.kind === "flags") this.#marked(name.replace("flags", "range"));
  }

  /** Average a range map over neighbors, for shading and contours only. Means do not cross
  steps of the surface; until steps are known, the map stays unchanged. */
  smooth(name, reach = this.reach) {
    this.reach = reach;
    const map = this.maps.get(name);
    if (!map) return;
    const steps = this.maps.get(name.replace("range", "steps"))?.values;
    map.smooth = averaged(map.values, this.wide, this.high, steps ? reach : 0, steps);
    this.renderer.keep(`smooth ${name}`, this.wide, this.high, map.smooth);
    this.#marked(name);
  }

  /** Mark steps, pixels off the surface, and pixels of triangles. Until steps are known, all
  pixels are off the surface, as are rows since the last recomputation. */
  #marked(name) {
    const map = this.maps.get(name);
    if (!map) return;
    const steps = this.maps.get(name.replace("range", "steps"))?.values;
    const flags = this.maps.get(name.replace("range", "flags"))?.values;
    const stray = this.flags
      .filter((flag) => ["mixed", "outlier"].includes(flag.name))
      .reduce((bits, flag) => bits | flag.mask, 0);
    const off = (at) =>
      !steps || this.fresh.has(Math.floor(at / this.wide)) || Boolean(flags && flags[at] & stray);
    const marks = surfaceMarks(map.values, steps ?? map.values, off, this.wide);
    if (!steps) marks.fill(4);
    map.marks = marks;
    this.version += 1;
    this.renderer.keep(`edges ${name}`, this.wide, this.high, Float32Array.from(marks));
  }

  /** Insert new rows; the maps must be loaded. */
  patch(name, first, values) {
    const map = this.maps.get(name);
    if (!map) return;
    this.version += 1;
    map.values.set(values, first * this.wide);
    const count = values.length / this.wide;
    for (let row = first; row < first + count; row += 1) this.fresh.add(row);
    const shown = map.layer.kind === "flags" ? flagRanks(values, this.flags) : values;
    this.renderer.rows(`map ${name}`, first, count, this.wide, shown);
  }

  /** Return a value of a pixel of the scan; NaN while it is missing. */
  value(name, row, column) {
    const map = this.maps.get(name);
    if (!map) return NaN;
    return map.values[Math.floor(row / this.stride) * this.wide + Math.floor(column / this.stride)];
  }

  /** Return the point of a pixel; null without a range. */
  point(row, column, name = this.main) {
    const range = this.value(name, row, column);
    return Number.isFinite(range) ? this.beams.point(row, column, range) : null;
  }

  /** Return the descriptions of a pixel's flags. */
  reasons(row, column, name = "flags") {
    const bits = this.value(name, row, column);
    return this.flags.filter((flag) => bits & flag.mask);
  }

  /** Return the half span of insignificant differences of a map: a hundredth of the range
  error, a tenth of an error in an error map, or rounding. */
  least(name) {
    const { values, layer } = this.maps.get(name);
    const middle = (all) => {
      const some = sampled(all, 4000)
        .filter(Number.isFinite)
        .sort((a, b) => a - b);
      return some.length ? Math.abs(some[some.length >> 1]) : 0;
    };
    if (layer.kind === "error") return middle(values) / 20 || ROUNDING;
    if (layer.kind === "chance") return ROUNDING;
    if (layer.unit !== "m") return middle(values) * 1e-6 || ROUNDING;
    const error = this.maps.get("uncertainty")?.values ?? [];
    return Math.max(middle(error) / 100, layer.kind === "range" ? 1e-6 : ROUNDING);
  }

  /** Return whether all of a map is 0 within rounding. */
  nothing(name) {
    const { values, layer } = this.maps.get(name);
    const small = (value) => !(Math.abs(value) >= ROUNDING);
    return layer.kind === "signed" && values.some(Number.isFinite) && values.every(small);
  }

  /** Return the color limits of a map without its extremes; symmetric for signed maps. */
  limits(name) {
    const { values, layer } = this.maps.get(name);
    if (layer.kind === "flags") return [0, 255];
    const some = sampled(values, 60000)
      .filter(Number.isFinite)
      .sort((a, b) => a - b);
    if (!some.length) return [0, 1];
    const at = (share) => some[Math.min(some.length - 1, Math.floor(share * some.length))];
    const [low, high] = [at(0.01), at(0.985)];
    const least = this.least(name);
    if (layer.kind === "signed") {
      const size = Math.max(Math.abs(low), Math.abs(high), least);
      return [-size, size];
    }
    if (layer.kind === "amplitude") return [0, high || 1];
    const half = Math.max((high - low) * 0.53, least);
    return [(low + high) / 2 - half, (low + high) / 2 + half];
  }

  /** Return the uniforms of this scene for the graphics card. */
  uniforms(name, limits, look) {
    const layer = this.about(name);
    const shape = look.raw && this.byName.has("range_before") ? "range_before" : this.main;
    return {
      layer: `map ${name}`,
      table: `table ${layer.kind === "flags" ? "flags" : MAP_OF[layer.kind]}`,
      textures: {
        uRange: `map ${shape}`,
        uSmooth: `smooth ${shape}`,
        uSteps: `edges ${shape}`,
        uBase: "base",
        uAim: "aim",
        uRows: "rows",
        uColumns: "columns",
      },
      set: {
        uSize: ["2i", this.wide, this.high],
        uLimits: ["2f", ...limits],
        uKind: ["1i", layer.kind === "flags" ? 1 : 0],
        uMissing: ["3f", ...look.missing],
        // Shading is for relief; on other maps it would change the meaning of colors.
        uLight: ["3f", ...(layer.kind === "range" ? look.light : [0, 0, 0])],
        uRelief: ["1f", look.relief],
        uContour: ["1f", look.contour],
        uGround: ["3f", ...look.ground],
        uClipped: ["1i", look.clip ? 1 : 0],
        uLow: ["3f", ...bounded(look.clip?.low ?? [0, 0, 0])],
        uHigh: ["3f", ...bounded(look.clip?.high ?? [0, 0, 0])],
      },
    };
  }
}

/** Return limits as numbers that every GPU compares. */
function bounded(ends) {
  return ends.map((value) => Math.min(Math.max(value, -1e9), 1e9));
}

function shares(nodes, count, stride) {
  const out = new Float32Array(2 * count);
  let before = 0;
  for (let k = 0; k < count; k += 1) {
    const at = k * stride;
    while (before < nodes.length - 1 && nodes[before + 1] <= at) before += 1;
    const next = Math.min(before + 1, nodes.length - 1);
    out[2 * k] = before;
    out[2 * k + 1] = (at - nodes[before]) / Math.max(nodes[next] - nodes[before], 1);
  }
  return out;
}

/** Return an even subset of about a given number of values. */
export function sampled(values, wanted) {
  const step = Math.max(1, Math.floor(values.length / wanted));
  const out = [];
  for (let at = 0; at < values.length; at += step) out.push(values[at]);
  return out;
}

/** Return means over squares of neighbors that no step separates from the pixel, along the
column and then the row. NaN stays NaN. As in amulor.imaging.edges.reached. */
function averaged(values, wide, high, reach, steps) {
  if (reach === 0) return Float32Array.from(values);
  const along = (source, count, length, step, stride, bit) => {
    const sums = new Float64Array(length + 1);
    const counts = new Int32Array(length + 1);
    const starts = new Int32Array(length);
    const out = {
      sum: new Float64Array(source.sum.length),
      count: new Float32Array(source.sum.length),
    };
    for (let line = 0; line < count; line += 1) {
      const at = (k) => line * stride + k * step;
      for (let k = 0; k < length; k += 1) {
        sums[k + 1] = sums[k] + source.sum[at(k)];
        counts[k + 1] = counts[k] + source.count[at(k)];
        starts[k] = k && !(steps[at(k - 1)] & bit) ? starts[k - 1] : k;
      }
      let end = length;
      for (let k = length - 1; k >= 0; k -= 1) {
        if (k < length - 1 && steps[at(k)] & bit) end = k + 1;
        const low = Math.max(starts[k], k - reach);
        const top = Math.min(end, k + reach + 1);
        out.sum[at(k)] = sums[top] - sums[low];
        out.count[at(k)] = counts[top] - counts[low];
      }
    }
    return out;
  };
  const there = {
    sum: Float64Array.from(values, (v) => (Number.isFinite(v) ? v : 0)),
    count: Float32Array.from(values, (v) => (Number.isFinite(v) ? 1 : 0)),
  };
  const across = along(there, high, wide, 1, wide, 1);
  const both = along(across, wide, high, wide, 1, 2);
  return Float32Array.from(values, (v, at) =>
    Number.isFinite(v) ? both.sum[at] / both.count[at] : NaN,
  );
}
