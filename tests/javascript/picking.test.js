// What is seen at a pixel, and lengths whose bounds hold however errors correlate.

import assert from "node:assert/strict";
import { test } from "node:test";

import { Camera, extent, projected } from "../../src/amulor/view/page/static/camera.js";
import {
  distanceOf,
  lengthAlong,
  numberAt,
  seen,
} from "../../src/amulor/view/page/static/picking.js";

const SIZE = { width: 400, height: 300 };

function cameraAt(options = {}) {
  const camera = new Camera();
  camera.home({ target: [0, 0, 1], size: 1 });
  camera.straight();
  return Object.assign(camera, options);
}

function seenAt(position, place, { camera = cameraAt(), faces = null, dot = 4 } = {}) {
  const matrix = camera.matrix(SIZE.width / SIZE.height);
  const [x, y] = projected(matrix, place, SIZE.width, SIZE.height);
  const shape = { position: Float32Array.from(position.flat()), faces, count: position.length };
  return seen(shape, matrix, { x, y, ...SIZE }, { dot, shrinks: !camera.orthographic });
}

test("of two points behind one another the nearer one is seen", () => {
  for (const orthographic of [false, true]) {
    const camera = cameraAt({ orthographic });
    const eye = camera.eye();
    // On the line of sight through the target: a far point, a near one, one behind the eye.
    const along = (far) => camera.target.map((part, k) => eye[k] + far * (part - eye[k]));
    const found = seenAt([along(1.2), along(0.8), along(-0.5), [0.4, 0, 1]], camera.target, {
      camera,
    });
    assert.deepEqual(found.corners, [1], `orthographic ${orthographic}`);
  }
});

test("beside all points nothing is seen, and points may be pointed at by their rims", () => {
  assert.equal(seenAt([[0, 0, 1]], [0.3, 0, 1]), null);
  const matrix = cameraAt().matrix(SIZE.width / SIZE.height);
  const perMetre = projected(matrix, [1, 0, 1], 400, 300)[0] - 200;
  const away = (pixels) => seenAt([[0, 0, 1]], [pixels / perMetre, 0, 1], { dot: 1 });
  // The least dot has a radius of 0.75 pixels, and 2.5 are added for the hand.
  assert.deepEqual(away(3.2).corners, [0]);
  assert.equal(away(3.3), null);
});

test("on a mesh the place lies in the triangle, and numbers between its corners", () => {
  const corners = [
    [-0.2, -0.2, 1.1],
    [0.3, -0.2, 0.9],
    [0, 0.3, 1],
  ];
  const behind = corners.map(([x, y, z]) => [2 * x, 2 * y, z + 0.4]);
  const faces = Uint32Array.from([3, 4, 5, 0, 1, 2]);
  const weights = [0.2, 0.5, 0.3];
  const place = [0, 1, 2].map((k) => corners.reduce((sum, one, n) => sum + weights[n] * one[k], 0));
  const found = seenAt([...corners, ...behind], place, { faces });
  assert.deepEqual(found.corners, [0, 1, 2]);
  found.place.forEach((part, k) => assert.ok(Math.abs(part - place[k]) < 1e-6));
  found.weights.forEach((part, k) => assert.ok(Math.abs(part - weights[k]) < 1e-6));
  const number = numberAt(Float32Array.from([10, 20, 40, 0, 0, 0]), found);
  assert.ok(Math.abs(number - 24) < 1e-4);
  assert.ok(Number.isNaN(numberAt(undefined, found)));
  assert.equal(seenAt(corners, [0.9, 0.9, 1], { faces: faces.slice(3) }), null);
});

function pick(place, corner) {
  return { place, corners: [corner], weights: [1] };
}

test("bounds along beams hold for every correlation of what is shared", () => {
  const places = [
    [0.1, 0.2, 1.5],
    [-0.4, 0.1, 1.2],
  ];
  const numbers = { uncertainty: [0.02, 0.03], common: [0.015, 0.01] };
  const scene = { numbers, beams: true, centre: [0, 0, 0] };
  const [one, other] = places.map(pick);
  const { value, bound } = distanceOf(scene, one, other);
  const apart = places[1].map((part, k) => part - places[0][k]);
  assert.ok(Math.abs(value - Math.hypot(...apart)) < 1e-12);
  const slopes = places.map(
    (place) =>
      place.reduce((sum, part, k) => sum + part * apart[k], 0) / Math.hypot(...place) / value,
  );
  const variances = [0, 0.25, 0.5, 0.75, 1].map((rho) => {
    const [a, b] = slopes.map((slope, n) => [
      slope * Math.sqrt(numbers.uncertainty[n] ** 2 - numbers.common[n] ** 2),
      slope * numbers.common[n],
    ]);
    return a[0] ** 2 + b[0] ** 2 + a[1] ** 2 + b[1] ** 2 - 2 * rho * a[1] * b[1];
  });
  const most = Math.sqrt(Math.max(...variances));
  assert.ok(Math.abs(bound / most - 1) < 1e-9, `${bound} against ${most}`);
});

test("where nothing is known of correlation, errors add up", () => {
  const numbers = { sigma_x: [1, 2], sigma_y: [3, 4], sigma_z: [5, 6] };
  const scene = { numbers, beams: false, centre: [0, 0, 0] };
  const [one, other] = [pick([0, 0, 0], 0), pick([1, 1, 1], 1)];
  assert.deepEqual(lengthAlong(scene, one, other, [0, 1, 0]), { value: 1, bound: 7 });
  const none = { numbers: {}, beams: false, centre: [0, 0, 0] };
  assert.ok(Number.isNaN(lengthAlong(none, one, other, [0, 1, 0]).bound));
  assert.ok(Number.isNaN(distanceOf(scene, one, one).bound));
});

test("a camera that fits places has all of them in view, and touches the edge", () => {
  const places = [
    [-0.3, 0.1, 0.8],
    [0.5, -0.4, 1.6],
    [0.2, 0.6, 1.1],
  ];
  for (const orthographic of [false, true]) {
    const camera = new Camera();
    camera.orthographic = orthographic;
    camera.home(extent(places));
    camera.orbit(0.3, -0.2);
    camera.fit(places, 4 / 3);
    const matrix = camera.matrix(4 / 3);
    const shares = places.map((place) => {
      const [x, y] = projected(matrix, place, 400, 300);
      return Math.max(Math.abs(x / 200 - 1), Math.abs(y / 150 - 1));
    });
    assert.ok(Math.abs(Math.max(...shares) - 0.92) < 1e-9, `${shares}`);
  }
});

test("places far off do not make the rest small", () => {
  const places = Array.from({ length: 400 }, (_, k) => [k / 400, (k % 7) / 7, 1 + (k % 3) / 3]);
  const alone = extent(places);
  const { size, inside } = extent([...places, [50, 0, 0], [0, -80, 0]]);
  assert.ok(Math.abs(size / alone.size - 1) < 0.02, `${size} against ${alone.size}`);
  assert.ok(inside.every((place) => Math.max(...place.map(Math.abs)) < 2));
});
