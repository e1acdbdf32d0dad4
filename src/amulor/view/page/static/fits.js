// Shapes fitted to pixels in a saved page, with uncertainty, as in amulor.imaging.measure.fits.

import { correlated, cross, minus, norm, ownVariance } from "./geometry.js";
import { eigen, inverted, leastSquares, product, slopes, solved } from "./linear.js";

/** @typedef {[number, number]} Pixel row and column of the scan */
/** @typedef {number[]} Vector */
/** @typedef {import("./geometry.js").Measured} Measured */
/**
 * @typedef {object} Points
 * @property {Vector[]} position [m]
 * @property {Vector[]} direction displacement per unit of range [1]
 * @property {(i: number, j: number) => number} covariance of ranges [m^2]
 * @property {number[]} noise variance of single pixels [m^2]
 * @property {Pixel[]} pixels
 */
/**
 * Shape with its parameters: residuals of points, and values that are stated.
 * @typedef {object} Shape
 * @property {(values: number[], position: Vector[]) => Float64Array} residuals
 * @property {(values: number[], position: Vector[]) => Float64Array} [displayed]
 * @property {(values: number[]) => Record<string, number>} derived
 * @property {number[][]} starts
 */

/** As in amulor.imaging.measure.fits. */
const MOST_PIXELS = 1500;
const SURE = 4;
const COVERAGE = 2;
const MISFIT = 1.5;
const [AXES, TRIED] = [24, 3];
const GRAZING = 0.2;
const FEWEST = { plane: 4, circle: 4, sphere: 5, cylinder: 6 };

const dot = product;
/** @type {(a: Vector, factor: number) => Vector} */
const times = (a, factor) => a.map((part) => part * factor);
/** @type {(a: Vector, b: Vector) => Vector} */
const plus = (a, b) => a.map((part, k) => part + b[k]);
/** @type {(a: Vector) => Vector} */
const unit = (a) => times(a, 1 / norm(a));
/** @type {(all: Vector[]) => Vector} */
const mean = (all) => times(all.reduce(plus), 1 / all.length);

/** @type {(name: string, vector: Vector) => Record<string, number>} */
const named = (name, vector) =>
  Object.fromEntries(vector.map((part, k) => [`${name}_${"xyz"[k]}`, part]));

/**
 * Return two axes perpendicular to a unit vector, by the reflection that takes it to the first
 * coordinate, as numpy does.
 * @param {Vector} axis
 */
export function acrossOf(axis) {
  const end = axis[0] < 0 ? 1 : -1;
  const mirror = [1, axis[1] / (axis[0] - end), axis[2] / (axis[0] - end)];
  const share = (end - axis[0]) / end;
  return [1, 2].map((k) => mirror.map((part, i) => Number(i === k) - share * mirror[k] * part));
}

/**
 * Return pixels of a scene as points, thinned evenly if they are more than a fit takes.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 * @param {string} kind
 * @param {{fewest?: number, most?: number}} [counts]
 * @returns {Points}
 */
export function pointsOf(scene, pixels, kind, { fewest = FEWEST[kind], most = MOST_PIXELS } = {}) {
  if (pixels.length < fewest)
    throw new Error(
      `A ${kind} needs at least ${fewest} usable pixels, these are ${pixels.length}.`,
    );
  const step = Math.ceil(Math.sqrt(pixels.length / most));
  const taken = pixels.filter(([row, column]) => !(row % step) && !(column % step));
  const noise = taken.map((pixel) => ownVariance(scene, pixel));
  if (!noise.every(Number.isFinite))
    throw new Error("The errors of these ranges are not known here: open the file by amulor view.");
  const beams = taken.map(([row, column]) => scene.beams.at(row, column));
  return {
    position: taken.map(([row, column], k) =>
      plus(beams[k].slice(0, 3), times(beams[k].slice(3, 6), scene.value("range", row, column))),
    ),
    direction: beams.map((beam) => beam.slice(3, 6)),
    covariance: correlated(scene, taken),
    noise,
    pixels: taken,
  };
}

/**
 * Return the centroid, the mean direction to the receiver, two axes across it, and the slopes
 * of the plane through the points.
 * @param {Points} points
 */
export function tangent({ position, direction }) {
  const middle = mean(position);
  const back = unit(times(mean(direction), -1));
  const across = acrossOf(back);
  const away = position.map((place) => minus(place, middle));
  const beside = across.map((axis) => away.map((place) => dot(place, axis)));
  const normal = beside.map((one) => beside.map((other) => dot(one, other)));
  const spread = eigen(normal);
  if (spread[1].value < 1e-18 * spread[0].value)
    throw new Error("The pixels lie on a line, through which many planes go.");
  const heights = away.map((place) => dot(place, back));
  const leaning = solved(
    normal,
    beside.map((one) => dot(one, heights)),
  );
  return { middle, back, across, leaning };
}

/** @type {(back: Vector, across: Vector[], values: number[]) => Vector} */
const normalOf = (back, across, values) =>
  unit(back.map((part, k) => part - values[0] * across[0][k] - values[1] * across[1][k]));

/**
 * @param {Points} points
 * @returns {Shape}
 */
function plane(points) {
  const { middle, back, across, leaning } = tangent(points);
  /** @type {(values: number[]) => Vector} */
  const normal = (values) => normalOf(back, across, values);
  /** @type {(values: number[], position: Vector[]) => Float64Array} */
  const apart = (values, position) => {
    const at = normal(values);
    return Float64Array.from(position, (place) => dot(minus(place, middle), at) - values[2]);
  };
  return {
    displayed: apart,
    residuals: (values, position) => {
      const at = normal(values);
      return apart(values, position).map((value, k) => value / dot(points.direction[k], at));
    },
    derived: (values) => {
      const at = normal(values);
      const tilt = Math.atan2(Math.hypot(at[0], at[1]), -at[2]);
      return { ...named("normal", at), offset: dot(middle, at) + values[2], tilt };
    },
    starts: [[...leaning, 0]],
  };
}

/**
 * Return center and radius of a circle by linear least squares.
 * @param {number[][]} flat
 */
function round(flat) {
  const columns = [flat.map(([x]) => 2 * x), flat.map(([, y]) => 2 * y), flat.map(() => 1)];
  const squares = flat.map(([x, y]) => x * x + y * y);
  const normal = columns.map((one) => columns.map((other) => dot(one, other)));
  const scale = normal.map((row, k) => 1 / Math.sqrt(row[k] || 1));
  const scaled = normal.map((row, i) => row.map((value, j) => value * scale[i] * scale[j]));
  const range = eigen(scaled);
  if (range[2].value < 1e-18 * range[0].value)
    throw new Error("The pixels lie too straight for a round shape; take more.");
  const [x, y, rest] = solved(
    normal,
    columns.map((column) => dot(column, squares)),
  );
  return [x, y, Math.sqrt(Math.max(rest + x * x + y * y, 0))];
}

/**
 * @param {Points} points
 * @returns {Shape}
 */
function circle({ position }) {
  const middle = mean(position);
  const away = position.map((place) => minus(place, middle));
  const moments = [0, 1, 2].map((i) =>
    [0, 1, 2].map((j) => away.reduce((sum, place) => sum + place[i] * place[j], 0)),
  );
  const [first, , shortest] = eigen(moments).map(({ vector }) => vector);
  const axis = shortest[2] <= 0 ? shortest : times(shortest, -1);
  const axes = [first, cross(axis, first), axis];
  const guess = round(away.map((place) => axes.slice(0, 2).map((one) => dot(place, one))));
  /** @type {(values: number[]) => Vector[]} */
  const placed = (values) => [
    axes.reduce((sum, one, k) => plus(sum, times(one, values[2 + k])), middle),
    unit(plus(axis, plus(times(axes[0], values[0]), times(axes[1], values[1])))),
  ];
  return {
    residuals: (values, at) => {
      const [centre, normal] = placed(values);
      const out = new Float64Array(2 * at.length);
      at.forEach((place, k) => {
        const from = minus(place, centre);
        const off = dot(from, normal);
        out[k] = off;
        out[at.length + k] = norm(minus(from, times(normal, off))) - values[5];
      });
      return out;
    },
    derived: (values) => {
      const [centre, normal] = placed(values);
      return { radius: values[5], ...named("centre", centre), ...named("normal", normal) };
    },
    starts: [[0, 0, guess[0], guess[1], 0, guess[2]]],
  };
}

/** Sphere or cylinder, by normal and curvature near the points: two slopes and an offset of the
tangent plane, the curvature, of a cylinder also the turn of its axis in that plane. */
class Bent {
  /** @param {Points} points */
  constructor(points) {
    this.points = points;
    const { middle, back, across, leaning } = tangent(points);
    this.middle = middle;
    this.back = back;
    this.across = across;
    this.leaning = leaning;
  }

  /** @param {number[]} values */
  placed(values) {
    const normal = normalOf(this.back, this.across, values);
    return { at: plus(this.middle, times(normal, values[2])), normal };
  }

  /**
   * @param {number[]} values
   * @param {Vector} normal
   */
  axis(values, normal) {
    const [first] = this.across;
    const reference = unit(minus(first, times(normal, dot(first, normal))));
    const beside = cross(normal, reference);
    return plus(times(reference, Math.cos(values[4])), times(beside, Math.sin(values[4])));
  }

  /**
   * Return the distances of positions from the surface, perpendicular or along the beams [m].
   * @param {number[]} values
   * @param {Vector[]} position
   * @param {boolean} along
   */
  #distances(values, position, along) {
    const { at, normal } = this.placed(values);
    const axis = values.length > 4 ? this.axis(values, normal) : null;
    return Float64Array.from(position, (place, k) => {
      let away = minus(place, at);
      if (axis) away = minus(away, times(axis, dot(away, axis)));
      const outward = plus(normal, times(away, values[3]));
      const size = norm(outward);
      const apart = (values[3] * dot(away, away) + 2 * dot(away, normal)) / (size + 1);
      if (!along) return apart;
      // Limited at grazing incidence; the far side counts more, since no beam gets there.
      const facing = -dot(outward, this.points.direction[k]) / Math.max(size, 1e-12);
      return (2 * apart) / (facing + Math.hypot(facing, 2 * GRAZING));
    });
  }

  /**
   * Return start parameters: plane through the points, curvature by least squares.
   * @param {number} [turn]
   */
  #start(turn) {
    const flat = [...this.leaning, 0, 0, ...(turn === undefined ? [] : [turn])];
    const { at, normal } = this.placed(flat);
    const axis = turn === undefined ? null : this.axis(flat, normal);
    const heights = [];
    const squares = [];
    for (const place of this.points.position) {
      let away = minus(place, at);
      if (axis) away = minus(away, times(axis, dot(away, axis)));
      heights.push(dot(away, normal));
      squares.push(-(dot(away, away) - heights[heights.length - 1] ** 2) / 2);
    }
    const columns = [squares.map(() => 1), squares];
    const [offset, curvature] = solved(
      columns.map((one) => columns.map((other) => dot(one, other))),
      columns.map((one) => dot(one, heights)),
    );
    return [flat[0], flat[1], offset, curvature, ...flat.slice(4)];
  }

  /** @returns {Shape} */
  shape(ball = true) {
    const { position } = this.points;
    /** @type {(values: number[], at: Vector[]) => Float64Array} */
    const residuals = (values, at) => this.#distances(values, at, true);
    /** @type {(values: number[], at: Vector[]) => Float64Array} */
    const displayed = (values, at) => this.#distances(values, at, false);
    if (ball) {
      return {
        residuals,
        displayed,
        starts: [this.#start()],
        derived: (values) => {
          const { at, normal } = this.placed(values);
          const centre = minus(at, times(normal, 1 / values[3]));
          return { radius: 1 / Math.abs(values[3]), ...named("centre", centre) };
        },
      };
    }
    const starts = Array.from({ length: AXES }, (_, k) => this.#start((k * Math.PI) / AXES))
      .map((values) => {
        const all = residuals(values, position);
        return { values, squares: dot(all, all) };
      })
      .sort((one, other) => one.squares - other.squares)
      .slice(0, TRIED)
      .map(({ values }) => values);
    return {
      residuals,
      displayed,
      starts,
      derived: (values) => {
        const { at, normal } = this.placed(values);
        const axis = this.axis(values, normal);
        const centre = minus(at, times(normal, 1 / values[3]));
        const point = plus(centre, times(axis, dot(minus(this.middle, centre), axis)));
        const sizes = axis.map(Math.abs);
        const sign = Math.sign(axis[sizes.indexOf(Math.max(...sizes))]);
        return {
          radius: 1 / Math.abs(values[3]),
          ...named("axis", times(axis, sign)),
          ...named("point", point),
        };
      },
    };
  }
}

const SHAPES = {
  plane,
  circle,
  sphere: (points) => new Bent(points).shape(),
  cylinder: (points) => new Bent(points).shape(false),
};

/** @param {number[]} values */
function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half] : (sorted[half - 1] + sorted[half]) / 2;
}

/**
 * Return the covariances of parameters and ranges.
 * @param {Float64Array[]} gain
 * @param {Points} points
 */
function propagated(gain, { covariance, noise }) {
  const along = gain.map((row) => new Float64Array(row.length));
  for (let i = 0; i < noise.length; i += 1) {
    for (let j = 0; j <= i; j += 1) {
      const shared = covariance(i, j);
      if (shared === 0) continue;
      for (let p = 0; p < gain.length; p += 1) {
        along[p][i] += gain[p][j] * shared;
        if (i !== j) along[p][j] += gain[p][i] * shared;
      }
    }
  }
  return along;
}

/**
 * Return a least-squares fit of a shape to points, with its uncertainty.
 * @param {string} kind
 * @param {Points} points
 * @param {Shape} [shape] by default the shape of this kind
 */
export function fitted(kind, points, shape = SHAPES[kind](points)) {
  const count = points.position.length;
  const spread = points.noise.map((noise, k) => Math.max(noise, 1e-4 * points.covariance(k, k)));
  const sigma = spread.map((value) => Math.max(Math.sqrt(value), 1e-12));
  const scale = median(sigma);
  /** @type {(values: number[]) => Float64Array} */
  const weighted = (values) =>
    shape.residuals(values, points.position).map((value, k) => (value * scale) / sigma[k % count]);
  const [best] = shape.starts
    .flatMap((start) => leastSquares(weighted, start) ?? [])
    .sort((one, other) => one.squares - other.squares);
  if (!best) throw new Error(`No ${kind} fits the pixels; choose another part or shape.`);
  const { at, squares } = best;
  const columns = slopes(weighted, at);
  const normal = columns.map((one) => columns.map((other) => product(one, other)));
  const factors = normal.map((row, k) => 1 / Math.sqrt(row[k]));
  const range = eigen(normal.map((row, i) => row.map((v, j) => v * factors[i] * factors[j])));
  if (!(range[0].value <= 1e10 * range[range.length - 1].value))
    throw new Error(`The pixels do not settle a ${kind}; take a larger part of it.`);
  const change = changes(shape, at, points).map((value, k) => (value * scale) / sigma[k % count]);
  const { misfit, chance, covariance } = judged({ points, columns, normal, change, squares });
  const values = shape.derived(at);
  const names = Object.keys(values);
  const byValue = slopes((own) => Object.values(shape.derived(own)), at);
  const uncertainties = Object.fromEntries(
    names.map((name, k) => {
      const row = byValue.map((column) => column[k]);
      const variance = dot(
        row,
        covariance.map((line) => dot(line, row)),
      );
      return [name, Math.sqrt(Math.max(variance, 0))];
    }),
  );
  const plain = (shape.displayed ?? shape.residuals)(at, points.position);
  const doubt = doubted(kind, misfit, chance, values.radius ?? 0, uncertainties.radius ?? 0);
  return {
    values,
    uncertainties,
    residual: Math.sqrt(product(plain, plain) / count),
    misfit,
    pixels: count,
    doubt,
  };
}

/**
 * Return the derivative of each residual with respect to the range of its point.
 * @param {Shape} shape
 * @param {number[]} values
 * @param {Points} points
 */
function changes({ residuals }, values, { position, direction }) {
  const step = 1e-6;
  const [more, less] = [step, -step].map((shift) =>
    residuals(
      values,
      position.map((place, k) => plus(place, times(direction[k], shift))),
    ),
  );
  return more.map((value, k) => (value - less[k]) / (2 * step));
}

/** Return chi-square per degree of freedom, its limit, and the covariance of the parameters. */
function judged({ points, columns, normal, change, squares }) {
  const count = points.noise.length;
  const inverse = inverted(normal);
  // Sums over kinds of residuals, in pixels.
  const steep = columns.map((column) => {
    const out = new Float64Array(count);
    column.forEach((value, k) => (out[k % count] += value * change[k]));
    return out;
  });
  const gain = inverse.map((row) => {
    const out = new Float64Array(count);
    row.forEach((factor, p) => steep[p].forEach((value, k) => (out[k] += factor * value)));
    return out;
  });
  const along = propagated(gain, points);
  const covariance = along.map((one) => gain.map((other) => product(one, other)));
  let expected = 0;
  change.forEach((value, k) => (expected += value ** 2 * points.covariance(k % count, k % count)));
  steep.forEach((row, p) => (expected -= 2 * product(row, along[p])));
  covariance.forEach((row, p) => row.forEach((value, q) => (expected += value * normal[q][p])));
  const freedom = Math.max(change.length - columns.length, 1);
  const misfit = expected > 0 ? squares / expected : 1;
  const chance = 1 + SURE * Math.sqrt(2 / freedom);
  const excess = misfit > chance ? misfit - 1 : 0;
  const scattered = covariance.map((row, p) =>
    row.map(
      (value, q) =>
        value +
        excess * points.noise.reduce((sum, noise, k) => sum + noise * gain[p][k] * gain[q][k], 0),
    ),
  );
  return { misfit, chance, covariance: scattered };
}

/**
 * Return the reason not to use the values of a fit; empty for a good fit.
 * @param {string} kind
 * @param {number} misfit
 * @param {number} chance
 * @param {number} radius
 * @param {number} error
 */
function doubted(kind, misfit, chance, radius, error) {
  if (kind !== "circle" && misfit > Math.max(chance, MISFIT))
    return `does not fit this shape (chi-square ${digits(misfit)} per degree of freedom)`;
  if (radius > 0 && SURE * error > radius) {
    const least = radius / (1 + (COVERAGE * error) / radius);
    return `radius not constrained by these pixels, above ${digits(least * 1e3)} mm; take a larger part of the shape, or a plane`;
  }
  return "";
}

/** @param {number} value */
const digits = (value) => String(Number(value.toPrecision(3)));

/** Return the root mean square departure of a surface from its plane, without the noise. */
function flatness({ residual, misfit, pixels }) {
  const noise = residual ** 2 / Math.max(misfit, 1e-12);
  const error = noise * Math.sqrt(2 / Math.max(pixels - 3, 1));
  const value = Math.sqrt(Math.max(residual ** 2 - noise, 0));
  const most = Math.sqrt(error);
  return {
    label: "flatness",
    value,
    uncertainty: value > 0 ? Math.min(error / (2 * value), most) : most,
    unit: "m",
  };
}

/** @param {string} name */
function unitOf(name) {
  if (name === "tilt") return "rad";
  return /^(offset|radius|centre|point)/.test(name) ? "m" : "1";
}

/**
 * Return a fit to pixels as a measurement, as the server does.
 * @param {Measured} scene
 * @param {string} kind
 * @param {Pixel[]} pixels
 */
export function fit(scene, kind, pixels) {
  const found = fitted(kind, pointsOf(scene, pixels, kind));
  const lines = Object.entries(found.values).map(([name, value]) => ({
    label: name.replace("_", " "),
    value,
    uncertainty: found.uncertainties[name],
    unit: unitOf(name),
  }));
  if (kind === "plane") {
    const tilt = lines.pop();
    lines.unshift(/** @type {any} */ (tilt), flatness(found));
  } else {
    const [radius] = lines;
    const [value, uncertainty] = [2 * radius.value, 2 * radius.uncertainty];
    lines.unshift({ label: "diameter", value, uncertainty, unit: "m" });
  }
  return {
    kind,
    channel: scene.channel,
    group_index: scene.group_index,
    error_unknown: scene.error_unknown,
    lines: found.doubt ? [] : lines,
    doubt: found.doubt,
    residual: found.residual,
    misfit: found.misfit,
    pixels: found.pixels,
  };
}
