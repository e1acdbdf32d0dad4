// Points of beams, and errors of lengths against sums written out by hand.

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  Beams,
  covariance,
  distance,
  dots,
  height,
  interpolated,
  nodesIn,
  surfaceMarks,
  triangles,
} from "../../src/amulor/view/page/static/geometry.js";

/** Beams at two pixels of one row: place, direction, azimuth, elevation of each. */
function twoBeams(one, other) {
  return new Beams({ rows: [0], columns: [0, 1] }, Float64Array.from([...one, ...other]));
}

function sceneOf(beams, maps, sharing = null) {
  return {
    beams,
    sharing,
    channel: "VV",
    group_index: 1.36,
    frequencies: [80e6],
    rows: 1,
    columns: 2,
    value: (name, row, column) => maps[name]?.[column] ?? NaN,
  };
}

const PIXELS = [
  [0, 0],
  [0, 1],
];
const RIGHT = [0, 0, 0, 1, 0, 0, 0, 0];
const FORWARD = [0, 0, 0, 0, 0, 1, 0, 0];

function close(actual, expected, relative = 1e-12) {
  assert.ok(
    Math.abs(actual - expected) <= relative * Math.abs(expected),
    `${actual} is not ${expected}`,
  );
}

test("lengths along a row are chords of its beams, along a column those of its origins", () => {
  const nodes = { rows: [0, 2, 6], columns: [0, 10, 20, 30] };
  // Beams fan out by 0.1 rad per node column, and start 3 mm lower per row.
  const values = nodes.rows.flatMap((row) =>
    nodes.columns.flatMap((column) => {
      const angle = 0.01 * column;
      return [0, 0.003 * row, 0, Math.sin(angle), 0, Math.cos(angle), angle, 0];
    }),
  );
  const beams = new Beams(nodes, Float64Array.from(values));
  const chord = 2 * 1.5 * Math.sin(0.05);
  beams.alongRow(2, 1.5).forEach((length, k) => close(length, k * chord, 1e-12));
  const down = beams.alongColumn(20, 1.5);
  [0, 0.006, 0.018].forEach((length, k) => close(down[k], length, 1e-12));
});

test("a table is interpolated between its rows and continued beyond both ends", () => {
  const [from, to] = [
    [0, 10, 20],
    [0, 2, 6],
  ];
  const found = [5, 10, 15, -5, 25].map((at) => interpolated(from, to, at));
  found.forEach((value, k) => close(value, [1, 2, 4, -1, 8][k]));
  close(interpolated([3], [7], 100), 7);
});

test("beams between nodes are bilinear in row and column", () => {
  const nodes = { rows: [0, 4, 10], columns: [0, 7] };
  // Each number of a beam is a plane over rows and columns, which interpolation keeps.
  const plane = (row, column, k) => k + 0.3 * row - 0.2 * column;
  const values = [];
  for (const row of nodes.rows)
    for (const column of nodes.columns)
      for (let k = 0; k < 8; k += 1) values.push(plane(row, column, k));
  const beams = new Beams(nodes, Float64Array.from(values));
  for (const [row, column] of [
    [0, 0],
    [3, 5],
    [4, 7],
    [9, 1],
    [10, 7],
  ]) {
    beams.at(row, column).forEach((value, k) => close(value + 10, plane(row, column, k) + 10));
  }
});

test("a range ends along its beam, from where the beam starts", () => {
  const beams = twoBeams([0.1, -0.2, 0.3, 0, 0.6, 0.8, 0, 0], FORWARD);
  const [x, y, z] = beams.point(0, 0, 2);
  close(x, 0.1);
  close(y, 1.0);
  close(z, 1.9);
});

test("the distance across a right angle, with independent errors", () => {
  const scene = sceneOf(twoBeams(RIGHT, FORWARD), {
    range: [3, 4],
    uncertainty: [0.01, 0.02],
  });
  const { lines, random } = distance(scene, PIXELS);
  close(lines[0].value, 5);
  // d = sqrt(a^2 + b^2), so that its slopes are 3/5 and 4/5.
  close(lines[0].uncertainty, Math.hypot(0.6 * 0.01, 0.8 * 0.02));
  close(random, lines[0].uncertainty);
});

test("an error that both pixels share alike leaves no relief", () => {
  const sharing = { alike: ["alike"], of_water: [] };
  const maps = { range: [1, 1.25], uncertainty: [0.05, 0.05], common: [0.03, 0.03] };
  const along = (alike) =>
    height(
      sceneOf(twoBeams(FORWARD, FORWARD), { ...maps, alike: [alike, alike] }, sharing),
      PIXELS,
      [0, 0, -2],
    );
  const { lines, random } = along(0.03);
  close(lines[0].value, -0.25);
  // Of 50 mm are 30 shared, which leaves 40 in each pixel.
  close(random, 0.04 * Math.SQRT2, 1e-9);
  close(lines[0].uncertainty, 0.04 * Math.SQRT2, 1e-9);
});

test("errors of the water turn with the modulation phase between two ranges", () => {
  const sharing = { alike: [], of_water: ["water"] };
  // Half a turn of the phase, 4 pi f n / c times the difference: the errors are opposite.
  const half = 299792458 / (4 * 80e6 * 1.36);
  for (const [apart, sign] of [
    [0, 1],
    [half / 2, 0],
    [half, -1],
  ]) {
    const maps = {
      range: [1, 1 + apart],
      uncertainty: [0.02, 0.02],
      common: [0.01, 0.01],
      water: [0.01, 0.01],
    };
    const matrix = covariance(sceneOf(twoBeams(FORWARD, RIGHT), maps, sharing), PIXELS);
    assert.ok(Math.abs(matrix[0][1] - sign * 1e-4) < 1e-15, `${apart}: ${matrix[0][1]}`);
    assert.equal(matrix[0][1], matrix[1][0]);
    close(matrix[0][0], 4e-4);
  }
});

test("a pixel is wholly correlated with itself", () => {
  const maps = { range: [1, 2], uncertainty: [0.02, 0.03] };
  const scene = sceneOf(twoBeams(FORWARD, RIGHT), maps);
  const matrix = covariance(scene, [
    [0, 0],
    [0, 0],
    [0, 1],
  ]);
  assert.deepEqual(
    matrix.map((row) => row.map((value) => Number(value.toFixed(12)))),
    [
      [4e-4, 4e-4, 0],
      [4e-4, 4e-4, 0],
      [0, 0, 9e-4],
    ],
  );
});

test("what cannot be measured is refused in words", () => {
  const maps = { range: [1, NaN], uncertainty: [0.02, 0.03] };
  const scene = sceneOf(twoBeams(FORWARD, RIGHT), maps);
  assert.throws(() => distance(scene, PIXELS), /Pixel \(0, 1\) holds no range/);
  const same = [
    [0, 0],
    [0, 0],
  ];
  assert.throws(() => distance(scene, same), /Both points are the same/);
});

const none = () => false;

test("a surface joins all pixels of a grid without steps", () => {
  assert.deepEqual(
    [...surfaceMarks([1, 1, 1, 1, 1, 1], new Array(6).fill(0), none, 3)],
    [8, 8, 8, 8, 8, 8],
  );
});

test("a surface ends at a step and keeps both sides", () => {
  // Columns 0 and 1 stand before columns 2 and 3, in two rows.
  const range = [1, 1, 2, 2, 1, 1, 2, 2];
  const marks = surfaceMarks(range, [0, 1, 0, 0, 0, 1, 0, 0], none, 4);
  assert.deepEqual([...marks], [8, 9, 8, 8, 8, 9, 8, 8]);
  // With a single column behind the step, it belongs to no triangle.
  const narrow = surfaceMarks([1, 1, 2, 1, 1, 2], [0, 1, 0, 0, 1, 0], none, 3);
  assert.deepEqual([...narrow], [8, 9, 0, 8, 9, 0]);
});

test("a missing or flagged corner leaves one triangle of a cell", () => {
  assert.deepEqual([...surfaceMarks([1, 1, 1, NaN], [0, 0, 0, 0], none, 2)], [8, 8, 8, 4]);
  assert.deepEqual([...surfaceMarks([NaN, 1, 1, 1], [0, 0, 0, 0], none, 2)], [4, 8, 8, 8]);
  const flagged = surfaceMarks([1, 1, 1, 1], [0, 0, 0, 0], (at) => at === 1, 2);
  assert.deepEqual([...flagged], [8, 4, 8, 8]);
});

test("steps to rows and columns part a corner from its cell", () => {
  // Pixel 0 steps to the right and down: only the triangle of the other three is there.
  assert.deepEqual([...surfaceMarks([2, 1, 1, 1], [3, 0, 0, 0], none, 2)], [3, 8, 8, 8]);
});

/** Area that triangles of nodes cover, each node at its row and column [pixel]. */
function covered(corners, places) {
  let area = 0;
  for (let at = 0; at < corners.length; at += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => places[corners[at + k]]);
    area += Math.abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
  }
  return area;
}

function gridPlaces(high, wide, step) {
  const along = (count) =>
    Array.from({ length: nodesIn(count, step) }, (_, k) => Math.min(k * step, count - 1));
  return along(high).flatMap((row) => along(wide).map((column) => [row, column]));
}

test("triangles cover a whole grid at every step of nodes and size of cells", () => {
  const [high, wide] = [6, 8];
  const range = new Array(high * wide).fill(1);
  const marks = surfaceMarks(range, new Array(range.length).fill(0), none, wide);
  for (const [step, stride] of [
    [1, 1],
    [1, 2],
    [1, 3],
    [2, 2],
    [2, 4],
    [3, 3],
    [1, 20],
  ]) {
    const corners = triangles(range, marks, wide, step, stride);
    const cells = (nodesIn(high, stride) - 1) * (nodesIn(wide, stride) - 1);
    assert.equal(corners.length, 6 * cells);
    close(covered(corners, gridPlaces(high, wide, step)), (high - 1) * (wide - 1));
  }
});

test("a coarse cell ends at a step within it", () => {
  // One row of cells, 8 pixels wide, with a step behind column 4: the cell of columns 3 to 6
  // keeps neither triangle, as both have a side along a row.
  const wide = 8;
  const range = Array.from({ length: 4 * wide }, (_, at) => (at % wide > 4 ? 2 : 1));
  const steps = range.map((_, at) => (at % wide === 4 ? 1 : 0));
  const marks = surfaceMarks(range, steps, none, wide);
  const corners = triangles(range, marks, wide, 1, 3);
  const columns = [...corners].map((node) => node % wide);
  assert.equal(corners.length, 12);
  assert.deepEqual([...new Set(columns)].sort(), [0, 3, 6, 7]);
  for (let at = 0; at < columns.length; at += 3) {
    const ends = columns.slice(at, at + 3);
    assert.ok(Math.max(...ends) <= 3 || Math.min(...ends) >= 6);
  }
});

test("dots are the pixels with a range that no triangle has", () => {
  const range = [1, 1, 2, 1, 1, NaN];
  const marks = surfaceMarks(range, [0, 1, 0, 0, 0, 0], none, 3);
  assert.deepEqual([...dots(range, marks, 3)], [2]);
  assert.deepEqual([...dots(range, null, 3)], [0, 1, 2, 3, 4]);
  assert.deepEqual([...dots(range, null, 3, 1, 2)], [0, 2]);
  assert.deepEqual([...dots(range, null, 3, 2)], [0, 1]);
});
