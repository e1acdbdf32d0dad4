// Surfaces of revolution in a saved page, as in amulor.imaging.measure.round_objects.

import { fitted, pointsOf, tangent } from "./fits.js";
import { cross, minus } from "./geometry.js";
import { inverted, leastSquares, product as dot, solved } from "./linear.js";

/** @typedef {[number, number]} Pixel row and column of the scan */
/** @typedef {number[]} Vector */
/** @typedef {import("./geometry.js").Measured} Measured */
/** @typedef {import("./fits.js").Points} Points */
/** @typedef {import("./fits.js").Shape} Shape */

/** As in amulor.imaging.measure.round_objects. */
const DIRECTIONS = 36;
const APART = Math.PI / 6;
const [FEWEST, MOST] = [60, 3200];
const [PIXELS_APART, MOST_KNOTS] = [2.5, 45];
const LOCAL = 1.5;
const HEIGHTS = 81;
const ROUND = 0.02;
const BEHIND = 0.05;
const OTHER = 5;
const GRAZING = 0.2;
const SURE = 4;
/** Scales of the robust fits [standard deviation], and their most steps. */
const LIMITS = [30, 3];
const ROBUST_STEPS = 30;

/** @type {(a: Vector, factor: number) => Vector} */
const times = (a, factor) => a.map((part) => part * factor);
/** @type {(a: Vector) => Vector} */
const unit = (a) => times(a, 1 / Math.sqrt(dot(a, a)));
/** @type {(low: number, high: number, count: number) => number[]} */
const evenly = (low, high, count) =>
  Array.from({ length: count }, (_, k) => low + ((high - low) * k) / (count - 1));
/** @type {(values: ArrayLike<number>) => number[]} */
const sorted = (values) => [...Float64Array.from(values).sort()];
/** @type {(values: ArrayLike<number>) => number} */
const largest = (values) => Array.from(values).reduce((most, value) => Math.max(most, value));

/** @param {ArrayLike<number>} values */
function median(values) {
  const all = sorted(values);
  const half = all.length >> 1;
  return all.length % 2 ? all[half] : (all[half - 1] + all[half]) / 2;
}

/** Cubic spline through values at knots, with no knot second from an end. */
class Spline {
  /** @param {number[]} knots ascending, at least four */
  constructor(knots) {
    this.knots = knots;
    const count = knots.length;
    const gap = knots.slice(1).map((knot, k) => knot - knots[k]);
    const [matrix, right] = [0, 1].map(() => knots.map(() => new Array(count).fill(0)));
    for (let k = 1; k < count - 1; k += 1) {
      matrix[k].splice(k - 1, 3, gap[k - 1], 2 * (gap[k - 1] + gap[k]), gap[k]);
      const [before, after] = [6 / gap[k - 1], 6 / gap[k]];
      right[k].splice(k - 1, 3, before, -before - after, after);
    }
    matrix[0].splice(0, 3, gap[1], -gap[0] - gap[1], gap[0]);
    const [last, ahead] = [gap[count - 2], gap[count - 3]];
    matrix[count - 1].splice(count - 3, 3, last, -last - ahead, ahead);
    const inverse = inverted(matrix);
    /** Second derivatives at the knots for values at the knots. */
    this.bending = inverse.map((row) =>
      knots.map((_, j) => row.reduce((sum, value, k) => sum + value * right[k][j], 0)),
    );
  }

  /** @param {number} at */
  interval(at) {
    const { knots } = this;
    let [low, high] = [0, knots.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (knots[middle] <= at) low = middle;
      else high = middle;
    }
    return low;
  }

  /**
   * Return a function of the value and the slope of the spline at a place.
   * @param {ArrayLike<number>} values at the knots
   * @returns {(at: number) => [number, number]}
   */
  through(values) {
    const bent = this.bending.map((row) => dot(row, values));
    return (at) => {
      const k = this.interval(at);
      const gap = this.knots[k + 1] - this.knots[k];
      const [before, after] = [(this.knots[k + 1] - at) / gap, (at - this.knots[k]) / gap];
      const curved =
        ((before ** 3 - before) * bent[k] + (after ** 3 - after) * bent[k + 1]) * (gap * gap);
      const turned = (3 * after ** 2 - 1) * bent[k + 1] - (3 * before ** 2 - 1) * bent[k];
      return [
        before * values[k] + after * values[k + 1] + curved / 6,
        (values[k + 1] - values[k]) / gap + (turned * gap) / 6,
      ];
    };
  }

  /**
   * Return the values at the knots whose spline is nearest to values at places.
   * @param {number[]} places
   * @param {number[]} values
   */
  nearest(places, values) {
    const columns = this.knots.map((_, k) => {
      const through = this.through(this.knots.map((__, j) => Number(j === k)));
      return Float64Array.from(places, (at) => through(at)[0]);
    });
    return solved(
      columns.map((one) => columns.map((other) => dot(one, other))),
      columns.map((column) => dot(column, values)),
    );
  }
}

/**
 * Return the level of each height; all levels have equally many pixels.
 * @param {number[]} height
 */
function levelsOf(height) {
  const count = Math.min(Math.max(Math.floor(height.length / 20), 3), 40);
  const all = sorted(height);
  const edges = Array.from({ length: count - 1 }, (_, k) => {
    const at = ((k + 1) / count) * (all.length - 1);
    const low = Math.floor(at);
    return all[low] + (at - low) * ((all[low + 1] ?? all[low]) - all[low]);
  });
  return height.map((value) => edges.filter((edge) => edge < value).length);
}

/**
 * Return the center of circles of one axis, one circle for each level of heights.
 * @param {number[]} x
 * @param {number[]} z
 * @param {number[]} level
 * @returns {[number, number]}
 */
function centreOf(x, z, level) {
  const count = largest(level) + 1;
  const squares = x.map((value, k) => value ** 2 + z[k] ** 2);
  const centred = [x.map((value) => 2 * value), z.map((value) => 2 * value), squares].map(
    (values) => {
      const [sums, sizes] = [new Float64Array(count), new Float64Array(count)];
      values.forEach((value, k) => {
        sums[level[k]] += value;
        sizes[level[k]] += 1;
      });
      return values.map((value, k) => value - sums[level[k]] / sizes[level[k]]);
    },
  );
  const [right, up, all] = centred;
  const [across, along] = solved(
    [
      [dot(right, right), dot(right, up)],
      [dot(up, right), dot(up, up)],
    ],
    [dot(right, all), dot(up, all)],
  );
  return [across, along];
}

/**
 * Return the trimmed mean square of radial distances from the circle at each height [m^2].
 * @param {Vector[]} away
 * @param {Vector} axis
 * @param {Vector} back
 */
function misfitOf(away, axis, back) {
  const side = cross(axis, back);
  const [x, z] = [side, back].map((line) => away.map((place) => dot(place, line)));
  const level = levelsOf(away.map((place) => dot(place, axis)));
  const [right, ahead] = centreOf(x, z, level);
  const radius = x.map((value, k) => Math.hypot(value - right, z[k] - ahead));
  /** @type {number[][]} */
  const members = Array.from({ length: largest(level) + 1 }, () => []);
  radius.forEach((value, k) => members[level[k]].push(value));
  const middles = members.map((values) => median(values));
  const squares = sorted(radius.map((value, k) => (value - middles[level[k]]) ** 2));
  const kept = squares.slice(0, Math.floor(0.9 * squares.length));
  return kept.reduce((sum, value) => sum + value, 0) / kept.length;
}

/**
 * Return the direction across the view about which circles fit best.
 * @param {Points} points
 */
function axisOf(points) {
  const { middle, back, across } = tangent(points);
  const away = points.position.map((place) => minus(place, middle));
  const trials = Array.from({ length: DIRECTIONS }, (_, k) => {
    const turn = (k * Math.PI) / DIRECTIONS;
    return across[0].map((part, i) => Math.cos(turn) * part + Math.sin(turn) * across[1][i]);
  });
  const misfits = trials.map((trial) => misfitOf(away, trial, back));
  const least = Math.min(...misfits);
  const axis = trials[misfits.indexOf(least)];
  const others = misfits.filter((_, k) => Math.abs(dot(trials[k], axis)) < Math.cos(APART));
  if (Math.min(...others) < (1 + 4 * Math.sqrt(2 / away.length)) * least)
    throw new Error(
      "The pixels do not settle the axis of a surface of revolution: another direction fits " +
        "them as well, as for a ball or a board; take a larger part.",
    );
  return axis[1] <= 0 ? axis : times(axis, -1);
}

/**
 * Return the knots of a profile, at heights with pixels only.
 * @param {number[]} height
 * @param {number[]} across
 */
function knotsOf(height, across) {
  const [all, beside] = [sorted(height), sorted(across)];
  const extent = all[all.length - 1] - all[0];
  const pixel = Math.sqrt((extent * (beside[beside.length - 1] - beside[0])) / all.length);
  const step = Math.max(PIXELS_APART * pixel, extent / (MOST_KNOTS - 1));
  const trial = evenly(all[0], all[all.length - 1], Math.max(Math.floor(extent / step) + 1, 5));
  const near = (trial[1] - trial[0]) / 2;
  return trial.filter((knot) => all.some((value) => Math.abs(value - knot) < near));
}

/** Surface of revolution near a start direction of its axis. Parameters are two slopes of the
axis, its offsets across and along the view, and the radii at the knots of the profile. */
class Turned {
  /**
   * @param {Points} points
   * @param {Vector} axis
   */
  constructor(points, axis) {
    this.points = points;
    const { middle, back } = tangent(points);
    this.middle = middle;
    this.axis = axis;
    this.back = unit(minus(back, times(axis, dot(back, axis))));
    this.across = cross(axis, this.back);
    const away = points.position.map((place) => minus(place, middle));
    const [height, x, z] = [axis, this.across, this.back].map((line) =>
      away.map((place) => dot(place, line)),
    );
    const knots = knotsOf(height, x);
    this.spline = new Spline(knots);
    this.heights = evenly(knots[0], knots[knots.length - 1], HEIGHTS);
    const [right, ahead] = centreOf(x, z, levelsOf(height));
    const radius = x.map((value, k) => Math.hypot(value - right, z[k] - ahead));
    this.start = [0, 0, right, ahead, ...this.spline.nearest(height, radius)];
  }

  /**
   * Return a point and the direction of the axis.
   * @param {ArrayLike<number>} values
   */
  placed(values) {
    /** @type {(first: number, one: number, other: number, from: Vector) => Vector} */
    const shifted = (first, one, other, from) =>
      from.map((part, k) => first * part + one * this.across[k] + other * this.back[k]);
    return {
      point: shifted(1, values[2], values[3], this.middle),
      axis: unit(shifted(1, values[0], values[1], this.axis)),
    };
  }

  /**
   * Return the distances of positions from the surface, perpendicular or along the beams [m].
   * @param {number[]} values
   * @param {Vector[]} position
   * @param {boolean} along
   */
  #distances(values, position, along) {
    const { point, axis } = this.placed(values);
    const through = this.spline.through(values.slice(4));
    return Float64Array.from(position, (place, k) => {
      const away = minus(place, point);
      const height = dot(away, axis);
      const radial = [0, 1, 2].map((i) => away[i] - height * axis[i]);
      const radius = Math.sqrt(dot(radial, radial));
      const [profile, slope] = through(height);
      const steep = Math.sqrt(1 + slope * slope);
      const apart = (radius - profile) / steep;
      if (!along) return apart;
      const aim = this.points.direction[k];
      const facing = (slope * dot(axis, aim) - dot(radial, aim) / Math.max(radius, 1e-12)) / steep;
      // Limited at grazing incidence.
      return (2 * apart) / (facing + Math.sqrt(facing * facing + 4 * GRAZING * GRAZING));
    });
  }

  /** @returns {Shape} */
  shape() {
    return {
      residuals: (values, position) => this.#distances(values, position, true),
      displayed: (values, position) => this.#distances(values, position, false),
      starts: [this.start],
      derived: (values) => {
        const { point, axis } = this.placed(values);
        const through = this.spline.through(values.slice(4));
        const names = [...point.map((_, k) => `point_${"xyz"[k]}`)];
        return {
          ...Object.fromEntries(axis.map((part, k) => [`axis_${"xyz"[k]}`, part])),
          ...Object.fromEntries(names.map((name, k) => [name, point[k]])),
          ...Object.fromEntries(this.heights.map((at, k) => [`radius_${k}`, through(at)[0]])),
        };
      },
    };
  }

  /** Return the parameters of a robust fit, and whether each pixel is on the surface. */
  robust() {
    const { covariance, noise, position } = this.points;
    const sigma = noise.map((value, k) => Math.sqrt(Math.max(value, 1e-4 * covariance(k, k))));
    /** @type {(values: number[]) => Float64Array} */
    const weighted = (values) =>
      this.#distances(values, position, true).map((value, k) => value / sigma[k]);
    let values = this.start;
    // Coarse at first: a profile through handles is far off.
    for (const limit of LIMITS)
      values =
        leastSquares(weighted, values, { limit, steps: ROBUST_STEPS, reached: 1e-8 })?.at ?? values;
    const residual = weighted(values).map(Math.abs);
    const spread = Math.max(1, 1.4826 * median(residual));
    return { values, near: Array.from(residual, (value) => value < OTHER * spread) };
  }
}

/**
 * Return the points that are chosen.
 * @param {Points} points
 * @param {boolean[]} chosen
 * @returns {Points}
 */
function subset(points, chosen) {
  const numbers = chosen.flatMap((one, k) => (one ? [k] : []));
  return {
    position: numbers.map((k) => points.position[k]),
    direction: numbers.map((k) => points.direction[k]),
    covariance: (i, j) => points.covariance(numbers[i], numbers[j]),
    noise: numbers.map((k) => points.noise[k]),
    pixels: numbers.map((k) => points.pixels[k]),
  };
}

/**
 * Return the spread of points around a profile near each height, in excess of noise [m].
 * @param {Points} points
 * @param {{point: Vector, axis: Vector}} placed
 * @param {number[]} heights
 * @param {number[]} radii
 */
function unresolved({ position, direction, noise }, { point, axis }, heights, radii) {
  const step = heights[1] - heights[0];
  const [square, random, count] = [0, 1, 2].map(() => new Float64Array(heights.length));
  position.forEach((place, n) => {
    const away = minus(place, point);
    const height = dot(away, axis);
    const radial = minus(away, times(axis, height));
    const radius = Math.sqrt(dot(radial, radial));
    const facing = dot(radial, direction[n]) / radius;
    const share = Math.min(Math.max((height - heights[0]) / step, 0), heights.length - 1);
    const low = Math.min(Math.floor(share), heights.length - 2);
    const profile = radii[low] + (share - low) * (radii[low + 1] - radii[low]);
    heights.forEach((at, k) => {
      if (!(Math.abs(at - height) < 2 * step)) return;
      square[k] += (radius - profile) ** 2;
      random[k] += noise[n] * Math.max(facing ** 2, GRAZING ** 2);
      count[k] += 1;
    });
  });
  return heights.map((_, k) =>
    Math.sqrt(Math.max((square[k] - LOCAL * random[k]) / Math.max(count[k], 1), 0)),
  );
}

/** Return the reason not to use a profile; empty if there is none. */
function doubted({ residual, misfit }, radii, errors, behind) {
  const widest = radii.indexOf(Math.max(...radii));
  if (behind > BEHIND)
    return `not round: ${Math.round(100 * behind)}% of the pixels lie behind the axis`;
  if (residual > ROUND * radii[widest] && misfit > LOCAL)
    return `not round: pixels lie ${Number((residual * 1e3).toPrecision(2))} mm off (rms)`;
  if (SURE * errors[widest] > radii[widest])
    return "radius not constrained by these pixels; take a larger part";
  return "";
}

/** Return diameters and the tilt of the axis with their uncertainty. */
function linesOf({ uncertainties }, axis, radii, uncertainty) {
  const lines = [
    ["rim diameter", radii.length - 1],
    ["largest diameter", radii.indexOf(Math.max(...radii))],
    ["base diameter", 0],
  ].map(([label, at]) => ({
    label,
    value: 2 * radii[at],
    uncertainty: 2 * uncertainty[at],
    unit: "m",
  }));
  const tilt = Math.acos(Math.min(Math.abs(axis[1]), 1));
  const error = Math.hypot(uncertainties.axis_x, uncertainties.axis_z);
  return [...lines, { label: "tilt of the axis", value: tilt, uncertainty: error, unit: "rad" }];
}

/**
 * Return the half-profile of a round object as a measurement, as the server does.
 * @param {Measured} scene
 * @param {Pixel[]} pixels
 */
export function halfProfileOf(scene, pixels) {
  const points = pointsOf(scene, pixels, "surface of revolution", { fewest: FEWEST, most: MOST });
  const guess = new Turned(points, axisOf(points));
  const { values, near } = guess.robust();
  const round = near.filter(Boolean).length;
  if (round < FEWEST)
    throw new Error(
      `Only ${round} of ${near.length} pixels lie on one surface of revolution, which needs ` +
        `${FEWEST}; choose a region of the round part.`,
    );
  const chosen = new Turned(subset(points, near), guess.placed(values).axis);
  const { heights } = chosen;
  const found = fitted("surface of revolution", chosen.points, chosen.shape());
  /** @type {(from: Record<string, number>, name: string) => Vector} */
  const vector = (from, name) => ["x", "y", "z"].map((at) => from[`${name}_${at}`]);
  const placed = { point: vector(found.values, "point"), axis: vector(found.values, "axis") };
  const radii = heights.map((_, k) => found.values[`radius_${k}`]);
  const errors = heights.map((_, k) => found.uncertainties[`radius_${k}`]);
  const hidden = chosen.points.position.filter(
    (place) => dot(minus(place, placed.point), chosen.back) < 0,
  );
  const doubt = doubted(found, radii, errors, hidden.length / chosen.points.position.length);
  const rough = unresolved(chosen.points, placed, heights, radii);
  const uncertainty = errors.map((error, k) => Math.hypot(error, rough[k]));
  return {
    kind: "profile",
    channel: scene.channel,
    group_index: scene.group_index,
    error_unknown: scene.error_unknown,
    lines: doubt ? [] : linesOf(found, placed.axis, radii, uncertainty),
    doubt,
    residual: found.residual,
    misfit: found.misfit,
    pixels: found.pixels,
    left_out: near.length - round,
    axis: [heights[0], heights[HEIGHTS - 1]].map((height) =>
      placed.point.map((part, k) => part + height * placed.axis[k]),
    ),
    profile: {
      height: heights.map((height) => height - heights[0]),
      radius: radii,
      uncertainty,
    },
  };
}
