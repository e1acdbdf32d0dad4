// Points of a scan from its ranges, and the errors of distances between them.

const LIGHT = 299792458;

function between(nodes, at) {
  let low = 0;
  let high = nodes.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (nodes[middle] <= at) low = middle;
    else high = middle - 1;
  }
  const next = Math.min(low + 1, nodes.length - 1);
  return [low, next, (at - nodes[low]) / Math.max(nodes[next] - nodes[low], 1)];
}

/** Beams of a scan, interpolated between the nodes of a coarse grid. */
export class Beams {
  constructor(nodes, values) {
    this.rows = nodes.rows;
    this.columns = nodes.columns;
    this.values = values;
  }

  /** Return the eight numbers of a beam: place, direction, azimuth, elevation. */
  at(row, column) {
    const [r0, r1, v] = between(this.rows, row);
    const [c0, c1, u] = between(this.columns, column);
    const width = this.columns.length;
    const out = new Array(8);
    for (let k = 0; k < 8; k += 1) {
      const get = (r, c) => this.values[(r * width + c) * 8 + k];
      out[k] =
        (get(r0, c0) * (1 - u) + get(r0, c1) * u) * (1 - v) +
        (get(r1, c0) * (1 - u) + get(r1, c1) * u) * v;
    }
    return out;
  }

  /** Return where a range along a beam ends: right, down, forward [m]. */
  point(row, column, range) {
    const b = this.at(row, column);
    return [b[0] + range * b[3], b[1] + range * b[4], b[2] + range * b[5]];
  }
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const norm = (a) => Math.hypot(a[0], a[1], a[2]);

/** Return the vector of a pixel in the basis of the reference, of length 1. */
function reference(sharing, beam) {
  if (!sharing.matrix) return null;
  const axes = [0, 1].map((k) => (beam[6 + k] - sharing.middle[k]) * sharing.factor[k]);
  const monomials = sharing.powers.map(([i, j]) => axes[0] ** i * axes[1] ** j);
  const width = sharing.matrix[0].length;
  const out = new Array(width).fill(0);
  monomials.forEach((value, k) => {
    for (let m = 0; m < width; m += 1) out[m] += value * sharing.matrix[k][m];
  });
  const size = Math.hypot(...out);
  return out.map((value) => value / size);
}

/** Return the covariance of the slant ranges of pixels, as amulor.imaging.correlation. */
export function covariance(scene, pixels) {
  const sharing = scene.sharing;
  const all = pixels.map(([row, column]) => {
    const beam = scene.beams.at(row, column);
    const get = (name) => scene.value(name, row, column);
    const total = get("uncertainty");
    if (!sharing) return { total };
    const alike = sharing.alike.map(get);
    const ofWater = sharing.of_water.map(get);
    const known = [...alike, ...ofWater].reduce((sum, one) => sum + one * one, 0);
    const common = get("common");
    return {
      total,
      range: get("range"),
      alike,
      ofWater,
      rest: Math.sqrt(Math.max(common * common - known, 0)),
      basis: reference(sharing, beam),
    };
  });
  const turns = scene.frequencies.map((f) => (4 * Math.PI * f * scene.group_index) / LIGHT);
  return all.map((one, i) =>
    all.map((other, j) => {
      if (i === j || samePixel(pixels[i], pixels[j])) return one.total ** 2;
      if (!sharing) return 0;
      const turn =
        turns.reduce((sum, k) => sum + Math.cos(k * (one.range - other.range)), 0) / turns.length;
      const along = one.basis ? one.basis.reduce((sum, v, k) => sum + v * other.basis[k], 0) : 1;
      const water = one.ofWater.reduce((sum, v, k) => sum + v * other.ofWater[k], 0);
      const alike = one.alike.reduce((sum, v, k) => sum + v * other.alike[k], 0);
      return one.rest * other.rest * along * turn + water * turn + alike;
    }),
  );
}

function samePixel(a, b) {
  return a[0] === b[0] && a[1] === b[1];
}

function pair(scene, pixels) {
  return pixels.map(([row, column]) => {
    const range = scene.value("range", row, column);
    if (!Number.isFinite(range))
      throw new Error(`Pixel (${row}, ${column}) holds no range; pick another.`);
    const beam = scene.beams.at(row, column);
    return { place: scene.beams.point(row, column, range), direction: beam.slice(3, 6) };
  });
}

function result(scene, kind, pixels, value, slopes) {
  const matrix = covariance(scene, pixels);
  let variance = 0;
  slopes.forEach((a, i) => slopes.forEach((b, j) => (variance += a * b * matrix[i][j])));
  let random = 0;
  slopes.forEach((a, i) => {
    const common = scene.sharing ? scene.value("common", ...pixels[i]) : 0;
    random += a * a * Math.max(matrix[i][i] - common * common, 0);
  });
  return {
    kind,
    channel: scene.channel,
    group_index: scene.group_index,
    lines: [{ label: kind, value, uncertainty: Math.sqrt(Math.max(variance, 0)), unit: "m" }],
    error_unknown: scene.error_unknown,
    random: Number.isFinite(random) ? Math.sqrt(random) : undefined,
    pixels: pixels.length,
  };
}

/** Return the distance of two pixels with its uncertainty. */
export function distance(scene, pixels) {
  const [one, other] = pair(scene, pixels);
  const step = minus(other.place, one.place);
  const length = norm(step);
  if (length === 0) throw new Error("Both points are the same; pick two that are apart.");
  const along = step.map((part) => part / length);
  return result(scene, "distance", pixels, length, [
    -dot(along, one.direction),
    dot(along, other.direction),
  ]);
}

/** Return how far the second pixel lies beyond the first along an axis. */
export function height(scene, pixels, axis = [0, -1, 0]) {
  const size = norm(axis);
  const up = axis.map((part) => part / size);
  const [one, other] = pair(scene, pixels);
  const value = dot(up, minus(other.place, one.place));
  return result(scene, "height", pixels, value, [
    -dot(up, one.direction),
    dot(up, other.direction),
  ]);
}
