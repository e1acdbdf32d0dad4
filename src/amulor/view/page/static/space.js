// The page of a point cloud or a mesh: colours, picks, lengths with what is known of them.

import { Camera, multiplied, projected } from "./camera.js";
import { flagColour, flagRanks, flagTable, MAP_OF, table } from "./colour.js";
import { colourBar, dot, fitted, halo, tag } from "./map.js";
import { distanceOf, lengthAlong, numberAt, seen } from "./picking.js";
import { failed, listMeasurements, say, showLegend, showReadout } from "./panel.js";
import { download, pictureOf, png, themed } from "./picture.js";
import { drawHistogram } from "./plots.js";
import { PointRenderer } from "./points.js";
import { MeasurementRecord, wireRecord } from "./record.js";
import { sampled } from "./scene.js";
import { SpaceSource } from "./source.js";
import { short, ticks, withUnit } from "./text.js";

const $ = (id) => document.getElementById(id);
/** Points that a moving view draws, and that a pointer is compared with while it moves. */
const MOVING = 400000;
const HOVERED = 250000;
const TOOLS = [
  { kind: "distance", name: "distance", hint: "Pick two points." },
  { kind: "height", name: "height", hint: "Pick the lower point, then the upper one." },
];
/** Axes of the file as the camera sees them: right, down, forward. */
const TURNS = {
  "-y": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
  y: [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1],
  z: [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1],
};
const UPWARDS = { "-y": [0, -1, 0], y: [0, 1, 0], z: [0, 0, 1] };

const state = {
  source: new SpaceSource(),
  scene: null,
  layerName: "height",
  limits: [0, 1],
  tables: {},
  flagColour,
  tool: null,
  picks: [],
  measurements: [],
  chosen: null,
  number: 0,
  up: "z",
  cursor: null,
  counted: "points",
};
const camera = new Camera();
let renderer;
let context;
let colours = {};
let waiting = 0;
let busy = 0;
let by = null;

function hint(text, wrong = false) {
  $("hint").textContent = text;
  $("hint").classList.toggle("wrong", wrong);
}

function redraw() {
  if (!waiting) waiting = requestAnimationFrame(draw);
}

function moved() {
  busy += 1;
  const now = busy;
  redraw();
  setTimeout(() => {
    if (busy === now) {
      busy = 0;
      redraw();
    }
  }, 180);
}

/** Return a place of the file as the camera sees it. */
function turned(place) {
  const m = TURNS[state.up];
  return [0, 1, 2].map((row) => m[row] * place[0] + m[4 + row] * place[1] + m[8 + row] * place[2]);
}

/** Return a direction of the camera in the axes of the file. */
function back(direction) {
  const m = TURNS[state.up];
  return [0, 1, 2].map(
    (column) =>
      m[4 * column] * direction[0] +
      m[4 * column + 1] * direction[1] +
      m[4 * column + 2] * direction[2],
  );
}

function look(canvas) {
  const matrix = multiplied(camera.matrix(canvas.width / canvas.height), TURNS[state.up]);
  const shrinks = !camera.orthographic;
  const focal = shrinks
    ? canvas.height / 2 / Math.tan(Camera.ANGLE / 2)
    : canvas.height / camera.span();
  const size = state.scene.spacing * 1.5 * 1.13 ** Number($("dot").value);
  return { matrix, shrinks, dot: size * focal };
}

function draw() {
  waiting = 0;
  const { scene } = state;
  if (!scene) return;
  const canvas = $("space");
  fitted(canvas);
  const ratio = canvas.width / Math.max(canvas.clientWidth, 1);
  const now = look(canvas);
  const { forward, right, up } = camera.frame();
  const light = [0, 1, 2].map((k) => -0.75 * forward[k] - 0.45 * right[k] + 0.5 * up[k]);
  const length = Math.hypot(...light);
  try {
    renderer.draw(context, {
      ...now,
      planes: camera.planes(),
      kind: by === "colour" ? 2 : scene.maps.get(state.layerName).layer.kind === "flags" ? 1 : 0,
      limits: state.limits,
      missing: colours.missing,
      ground: colours.ground,
      light: back(light.map((part) => part / length)),
      forward: back(forward),
      step: $("edges").checked ? camera.start.size * 0.02 : 0,
      reach: ratio * 1.4,
      most: busy ? MOVING : Infinity,
    });
  } catch (error) {
    failed(error);
    return;
  }
  marks(now, canvas, ratio);
  const { layer } = scene.maps.get(state.layerName);
  const plain = by === "colour" || layer.kind === "flags";
  $("bar").parentElement.hidden = plain;
  if (!plain) {
    const unit = unitOf(layer);
    colourBar(
      $("bar"),
      state.tables[layer.kind],
      state.limits.map((value) => value * unit.factor),
      unit.unit,
      colours,
    );
    $("unit").textContent = unit.unit;
  }
  drawHistogram($("histogram"), state, colours);
  canvas.dataset.layer = by;
  document.documentElement.dataset.ready = "yes";
}

function unitOf(layer) {
  if (layer.unit !== "m") return { unit: layer.unit, factor: 1 };
  const most = Math.max(...state.limits.map(Math.abs));
  return most < 0.5 ? { unit: "mm", factor: 1e3 } : { unit: "m", factor: 1 };
}

function marks({ matrix }, canvas, ratio) {
  const spotOf = (pick) => projected(matrix, pick.place, canvas.width, canvas.height);
  const chains = [
    ...state.measurements.map((kept) => ({ ...kept, strong: kept === state.chosen })),
    { picks: state.picks, strong: true },
  ];
  for (const { picks, strong, number } of chains) {
    const spots = picks.map(spotOf).filter(Boolean);
    const colour = strong ? colours.accent : colours.mark;
    if (spots.length > 1) {
      halo(context, 1.5 * ratio, { ...colours, mark: colour }, () => {
        context.beginPath();
        spots.forEach(([x, y], k) => (k ? context.lineTo(x, y) : context.moveTo(x, y)));
      });
    }
    spots.forEach((spot) => dot(context, spot, 4.5 * ratio, colour));
    if (number && spots[0])
      tag(
        context,
        String(number),
        [spots[0][0] + 8 * ratio, spots[0][1] - 8 * ratio],
        ratio,
        colours,
      );
  }
  const at = state.cursor && spotOf(state.cursor);
  if (at) dot(context, at, 5 * ratio, colours.cursor);
  if (document.activeElement === canvas && canvas.matches(":focus-visible")) cross(canvas, ratio);
  axes(canvas, ratio);
  if (camera.orthographic) scaleBar(canvas, ratio);
}

/** The middle, where Enter picks. */
function cross(canvas, ratio) {
  const [x, y] = [canvas.width / 2, canvas.height / 2];
  halo(context, ratio, colours, () => {
    context.beginPath();
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ]) {
      context.moveTo(x + 4 * ratio * dx, y + 4 * ratio * dy);
      context.lineTo(x + 13 * ratio * dx, y + 13 * ratio * dy);
    }
  });
}

function axes(canvas, ratio) {
  const { right, up, forward } = camera.frame();
  const origin = [46 * ratio, canvas.height - 42 * ratio];
  const inner = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  context.save();
  context.font = `${11 * ratio}px ${colours.font}`;
  context.textBaseline = "middle";
  context.textAlign = "center";
  context.lineWidth = 2 * ratio;
  [
    ["x", [1, 0, 0], "#D55E00"],
    ["y", [0, 1, 0], "#009E73"],
    ["z", [0, 0, 1], "#0072B2"],
  ]
    .map(([name, axis, colour]) => [name, colour, turned(axis)])
    .map(([name, colour, axis]) => ({
      name,
      colour,
      x: inner(axis, right),
      y: -inner(axis, up),
      z: inner(axis, forward),
    }))
    .sort((a, b) => b.z - a.z)
    .forEach(({ name, colour, x, y }) => {
      context.strokeStyle = colour;
      context.beginPath();
      context.moveTo(...origin);
      context.lineTo(origin[0] + x * 21 * ratio, origin[1] + y * 21 * ratio);
      context.stroke();
      if (Math.hypot(x, y) < 0.3) return;
      context.fillStyle = colours.soft;
      context.fillText(name, origin[0] + x * 30 * ratio, origin[1] + y * 30 * ratio);
    });
  context.restore();
}

function scaleBar(canvas, ratio) {
  const perMetre = canvas.height / camera.span();
  const { step } = ticks(0, (150 * ratio) / perMetre, 1.2);
  const length = step * perMetre;
  const [end, low] = [canvas.width - 18 * ratio, canvas.height - 20 * ratio];
  context.save();
  context.strokeStyle = context.fillStyle = colours.ink;
  context.lineWidth = 2 * ratio;
  context.beginPath();
  context.moveTo(end - length, low - 5 * ratio);
  context.lineTo(end - length, low);
  context.lineTo(end, low);
  context.lineTo(end, low - 5 * ratio);
  context.stroke();
  context.font = `${12 * ratio}px ${colours.font}`;
  context.textAlign = "center";
  context.fillText(withUnit(step, "m", 2), end - length / 2, low - 8 * ratio);
  context.restore();
  state.bar = { metres: step, pixels: length };
}

function home() {
  const { position } = state.scene;
  const some = sampled(
    Array.from({ length: position.length / 3 }, (_, i) => i),
    6000,
  )
    .map((i) => turned(position.subarray(3 * i, 3 * i + 3)))
    .filter((place) => place.every(Number.isFinite));
  const ends = [0, 1, 2].map((k) => {
    const sorted = some.map((place) => place[k]).sort((a, b) => a - b);
    return [
      sorted[Math.floor(0.01 * sorted.length)],
      sorted[Math.floor(0.99 * (sorted.length - 1))],
    ];
  });
  const size = Math.hypot(...ends.map(([low, high]) => high - low)) || 0.1;
  camera.home({ target: ends.map(([low, high]) => (low + high) / 2), size });
  state.places = some.filter((place) =>
    place.every((part, k) => part >= ends[k][0] && part <= ends[k][1]),
  );
  fit();
}

function fit() {
  const { clientWidth, clientHeight } = $("space");
  if (clientHeight) camera.fit(state.places, clientWidth / clientHeight);
}

/** Return the heights of all points, in the axes that are chosen. */
function heights() {
  const { position, centre } = state.scene;
  const up = UPWARDS[state.up];
  const values = new Float32Array(position.length / 3);
  for (let i = 0; i < values.length; i += 1) {
    values[i] = [0, 1, 2].reduce((sum, k) => sum + up[k] * (position[3 * i + k] + centre[k]), 0);
  }
  return { layer: { name: "height", label: "Height", unit: "m", kind: "range" }, values };
}

function limitsOf({ layer, values }) {
  if (layer.kind === "flags") return [0, 255];
  const some = sampled(values, 60000)
    .filter(Number.isFinite)
    .sort((a, b) => a - b);
  if (!some.length) return [0, 1];
  const [low, high] = [0.01, 0.985].map(
    (share) => some[Math.min(some.length - 1, Math.floor(share * some.length))],
  );
  if (layer.kind === "signed")
    return [-1, 1].map((sign) => sign * (Math.max(Math.abs(low), Math.abs(high)) || 1e-6));
  if (layer.kind === "amplitude") return [0, high || 1];
  const room = (high - low || Math.abs(high) || 1e-3) * 0.03;
  return [low - room, high + room];
}

function show(name) {
  const { scene } = state;
  by = name;
  if (name !== "colour") {
    state.layerName = name;
    const map = scene.maps.get(name);
    state.limits = limitsOf(map);
    const flags = map.layer.kind === "flags";
    renderer.colours(flags ? flagTable(scene.flags, "#2c7f62") : state.tables[map.layer.kind]);
    renderer.numbers(flags ? flagRanks(map.values, scene.flags) : map.values);
    $("legend").hidden = !flags;
    if (flags) showLegend(map.values, scene.flags);
  } else $("legend").hidden = true;
  for (const button of $("colours").children)
    button.setAttribute("aria-pressed", String(button.dataset.layer === name));
  redraw();
}

function places(place) {
  const { centre, size } = state.scene;
  // As many digits as the numbers have that came here.
  const digits = Math.min(Math.max(Math.ceil(-Math.log10(Math.max(...size) * 2 ** -23)), 0), 6);
  return place.map((part, k) => (part + centre[k]).toFixed(Math.min(digits, 5)).replace("-", "−"));
}

function bounded(value, bound) {
  if (!Number.isFinite(bound)) return `${withUnit(value, "m", 5)} (error not known)`;
  const factor = Math.abs(value) < 10 ? 1e3 : 1;
  const error = bound * factor;
  const digits = Math.min(Math.max(0, 1 - Math.floor(Math.log10(error || 1))), 6);
  return `${(value * factor).toFixed(digits).replace("-", "−")} mm ± at most ${error.toFixed(digits)} mm`.replaceAll(
    "mm",
    factor === 1 ? "m" : "mm",
  );
}

function readout() {
  const { scene, cursor } = state;
  const rows = [];
  const add = (term, text, kind = "") => rows.push([term, text, kind]);
  if (cursor) {
    const [x, y, z] = places(cursor.place);
    add("x", `${x} m`, "big");
    add("y", `${y} m`, "big");
    add("z", `${z} m`, "big");
    for (const { layer, values } of scene.maps.values()) {
      if (layer.kind === "flags" || (layer.kind === "hidden" && layer.name !== "common")) continue;
      if (layer.name === "height") continue;
      const value = numberAt(values, cursor);
      const label = layer.name === "common" ? "shared part" : layer.label.toLowerCase();
      add(
        label,
        layer.unit ? withUnit(value, layer.unit, layer.kind === "error" ? 2 : 4) : short(value, 4),
      );
    }
    const sigmas = ["x", "y", "z"].map((axis) => numberAt(scene.numbers[`sigma_${axis}`], cursor));
    if (sigmas.every(Number.isFinite))
      add("of x, y, z", sigmas.map((part) => short(part * 1e3, 2)).join(", ") + " mm");
  }
  if (!cursor) {
    const words = matchMedia("(pointer: coarse)").matches
      ? "Tap a point."
      : "Point at a point, or press Enter for what is in the middle of the view.";
    showReadout([["none yet", words, "words"]], []);
    return;
  }
  const flags =
    cursor && scene.numbers.flags
      ? scene.flags.filter((flag) => scene.numbers.flags[cursor.corners[0]] & flag.mask)
      : [];
  showReadout(rows, flags);
}

function choose(kind) {
  state.tool = state.tool === kind ? null : kind;
  state.picks = [];
  for (const button of $("tools").children)
    button.setAttribute("aria-pressed", String(button.dataset.kind === state.tool));
  hint(
    state.tool
      ? TOOLS.find((tool) => tool.kind === state.tool).hint
      : "Choose what to measure, then pick points.",
  );
  redraw();
}

function measured(kind, [one, other]) {
  const { scene } = state;
  const up = UPWARDS[state.up];
  const { value, bound } =
    kind === "height" ? lengthAlong(scene, one, other, up) : distanceOf(scene, one, other);
  const rests = [];
  if (kind === "distance") {
    const apart = other.place.map((part, k) => part - one.place[k]);
    const high = apart.reduce((sum, part, k) => sum + part * up[k], 0);
    const digits =
      bound > 0 ? Math.min(Math.max(Math.ceil(Math.log10(value / bound)) + 1, 1), 6) : 5;
    rests.push(
      `level ${withUnit(Math.sqrt(Math.max(value ** 2 - high ** 2, 0)), "m", digits)}`,
      `height ${withUnit(high, "m", digits)}`,
    );
  }
  const where = [one, other].map((pick) => `(${places(pick.place).join(", ")})`).join(" to ");
  return { value, bound: Number.isFinite(bound) ? bound : null, rests: rests.join(" · "), where };
}

function picked(pick) {
  state.cursor = pick;
  readout();
  if (state.tool) {
    state.picks.push(pick);
    if (state.picks.length === 2) {
      state.number += 1;
      const kept = {
        kind: state.tool,
        picks: state.picks,
        found: measured(state.tool, state.picks),
        number: state.number,
        file: state.scene.name,
      };
      state.chosen = kept;
      state.picks = [];
      state.record.change([...state.measurements, kept]);
      hint(TOOLS.find((tool) => tool.kind === state.tool).hint);
    } else hint("1 of 2 picked.");
  }
  redraw();
}

function listed() {
  const said = (kept) => ({
    main: bounded(kept.found.value, kept.found.bound ?? NaN),
    words: [kept.kind, kept.found.rests].filter(Boolean).join(" · "),
  });
  listMeasurements(state, said, redraw);
}

function asRows() {
  return state.measurements.map(({ number, kind, file, found }) => ({
    number,
    kind,
    value: found.value,
    standard_uncertainty_at_most: found.bound,
    unit: "m",
    file,
    where_m: found.where,
  }));
}

function asText() {
  const { scene } = state;
  const lines = [
    `${scene.title} (${scene.name})`,
    "± is a bound of one standard uncertainty: the file does not say how errors of two points correlate.",
  ];
  for (const kept of state.measurements)
    lines.push(
      "",
      `${kept.number}. ${kept.kind}: ${bounded(kept.found.value, kept.found.bound ?? NaN)}`,
      `   ${kept.found.where} m`,
    );
  return `${lines.join("\n")}\n`;
}

const stem = () => state.scene.name.replace(/\.\w+$/, "");

async function picture() {
  const map = state.scene.maps.get(state.layerName);
  const unit = unitOf(map.layer);
  const plain = by === "colour" || map.layer.kind === "flags";
  const words = [
    [$("subtitle").textContent],
    camera.orthographic ? [] : ["In perspective: no scale."],
    state.measurements.map(
      (kept) =>
        `${kept.number}: ${kept.kind} ${bounded(kept.found.value, kept.found.bound ?? NaN)}`,
    ),
  ].flat();
  const bar = plain
    ? null
    : {
        table: state.tables[map.layer.kind],
        limits: state.limits.map((value) => value * unit.factor),
        unit: unit.unit,
        label: map.layer.label,
      };
  draw();
  download(
    `${stem()}-view.png`,
    await png(pictureOf({ view: $("space"), title: state.scene.title, words, bar, colours })),
  );
}

async function saved() {
  if (state.source.saved) return hint("This page is a saved one.", true);
  return download(`${stem()}.html`, await state.source.page(state.measurements));
}

function seenAt(x, y) {
  const canvas = $("space");
  const { position, faces } = state.scene;
  return seen(
    { position, faces, count: position.length / 3 },
    look(canvas).matrix,
    { x, y, width: canvas.width, height: canvas.height },
    look(canvas),
  );
}

function seenBy(event) {
  const box = $("space").getBoundingClientRect();
  const ratio = $("space").width / box.width;
  return seenAt((event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio);
}

function orthographic() {
  camera.orthographic = !camera.orthographic;
  $("ortho").setAttribute("aria-pressed", String(camera.orthographic));
}

const KEYS = {
  r: home,
  o: orthographic,
  f: () => {
    camera.straight();
    fit();
  },
  t: () => {
    camera.above();
    fit();
  },
  d: () => {
    colours = themed(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  },
  s: () => saved().catch(failed),
  p: () => picture().catch(failed),
  "?": () => $("keys").showModal(),
  "+": () => camera.zoom(0.8),
  "-": () => camera.zoom(1.25),
  Escape: () => choose(null),
  Enter: () => {
    const pick = seenAt($("space").width / 2, $("space").height / 2);
    if (pick) picked(pick);
    else hint("Nothing is in the middle of the view.", true);
  },
};

function keyed(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || $("keys").open || !state.scene)
    return undefined;
  const into = event.target;
  if (into instanceof HTMLInputElement || into instanceof HTMLSelectElement) return undefined;
  if (event.key.startsWith("Arrow") && into === $("space")) {
    event.preventDefault();
    const [dx, dy] = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, -1],
      ArrowDown: [0, 1],
    }[event.key];
    if (event.shiftKey) camera.pan(dx * 0.05, dy * 0.05);
    else camera.orbit(dx * 0.08, dy * 0.08);
    return moved();
  }
  if ((event.key === "Enter" || event.key === " ") && into instanceof HTMLButtonElement)
    return undefined;
  const layer = $("colours").children[Number(event.key) - 1];
  if (layer) return show(layer.dataset.layer);
  const act = KEYS[event.key] ?? KEYS[event.key.toLowerCase()];
  if (act) {
    act();
    redraw();
  }
  return undefined;
}

function pointed(canvas) {
  const pointers = new Map();
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      camera.zoom(Math.exp(event.deltaY * 0.0013));
      moved();
    },
    { passive: false },
  );
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, moved: 0 });
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) {
      const { scene } = state;
      if (!scene || (scene.faces ? scene.faces.length / 3 : scene.position.length / 3) > HOVERED)
        return;
      const pick = seenBy(event);
      if (pick) {
        state.cursor = pick;
        readout();
        redraw();
      }
      return;
    }
    const [dx, dy, tall] = [
      event.clientX - pointer.x,
      event.clientY - pointer.y,
      canvas.clientHeight,
    ];
    pointer.moved += Math.abs(dx) + Math.abs(dy);
    if (pointers.size === 2) {
      const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const span = (x, y) => Math.max(Math.hypot(x - other.x, y - other.y), 1);
      camera.zoom(span(pointer.x, pointer.y) / span(event.clientX, event.clientY));
      camera.pan(dx / 2 / tall, dy / 2 / tall);
    } else if (event.shiftKey || event.buttons & 6) camera.pan(dx / tall, dy / tall);
    else camera.orbit((dx / tall) * 3.2, (dy / tall) * 3.2);
    Object.assign(pointer, { x: event.clientX, y: event.clientY });
    moved();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      const pointer = pointers.get(event.pointerId);
      pointers.delete(event.pointerId);
      if (!pointer || pointer.moved >= 6 || name !== "pointerup") return;
      const pick = seenBy(event);
      if (pick) picked(pick);
    });
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => {
    home();
    moved();
  });
  for (const name of ["focus", "blur"]) canvas.addEventListener(name, redraw);
}

function wired() {
  pointed($("space"));
  const clicks = {
    save: KEYS.s,
    theme: KEYS.d,
    help: KEYS["?"],
    ortho: KEYS.o,
    front: KEYS.f,
    top: KEYS.t,
    home: KEYS.r,
    picture: KEYS.p,
  };
  for (const [id, act] of Object.entries(clicks)) {
    $(id).addEventListener("click", () => {
      act();
      redraw();
    });
  }
  wireRecord(state, {
    download,
    hint,
    stem,
    text: asText,
    rows: asRows,
    content: () => ({
      file: state.scene.name,
      title: state.scene.title,
      measurements: state.measurements,
    }),
  });
  for (const id of ["dot", "edges"]) $(id).addEventListener("input", redraw);
  $("up").addEventListener("input", (event) => {
    state.up = event.target.value;
    state.scene.maps.set("height", heights());
    home();
    show(by);
  });
  $("tools").replaceChildren(
    ...TOOLS.map((tool) => {
      const button = Object.assign(document.createElement("button"), {
        type: "button",
        textContent: tool.name,
        title: tool.hint,
      });
      button.dataset.kind = tool.kind;
      button.setAttribute("aria-pressed", "false");
      button.addEventListener("click", () => choose(tool.kind));
      return button;
    }),
  );
  if (state.source.saved) $("save").hidden = true;
  hint("Choose what to measure, then pick points.");
  document.addEventListener("keydown", keyed);
  new ResizeObserver(redraw).observe(document.querySelector("main"));
}

async function opened() {
  const scene = await state.source.scene();
  scene.position = await state.source.numbers("position");
  scene.faces = scene.mesh ? await state.source.numbers("faces", Uint32Array) : null;
  renderer.keep(scene.position, scene.faces);
  renderer.own(
    scene.colour
      ? await state.source.numbers("colour", Uint8Array)
      : new Uint8Array(scene.position.length),
  );
  state.scene = scene;
  state.up = scene.up;
  $("up").value = scene.up;
  scene.numbers = {};
  scene.maps = new Map([["height", heights()]]);
  for (const layer of scene.layers) {
    const values = await state.source.numbers(layer.name);
    scene.numbers[layer.name] = values;
    scene.maps.set(layer.name, { layer, values });
  }
  document.title = `${scene.title} · amulor`;
  $("title").textContent = scene.title;
  const size = scene.size.map((part) => withUnit(part, "m", 3)).join(" × ");
  const number = (count) => count.toLocaleString("en");
  const shown = scene.mesh
    ? `${number(scene.triangles)} triangles, ${number(scene.points)} vertices`
    : scene.points < scene.total
      ? `${number(scene.points)} of ${number(scene.total)} points`
      : `${number(scene.points)} points`;
  $("subtitle").textContent = [scene.name, shown, size, scene.simulated && "simulated"]
    .filter(Boolean)
    .join(" · ");
  $("notes-card").hidden = !scene.notes.length;
  $("notes").replaceChildren(
    ...scene.notes.map((note) =>
      Object.assign(document.createElement("li"), { textContent: note }),
    ),
  );
  const names = [...scene.maps.keys()].filter(
    (name) => scene.maps.get(name).layer.kind !== "hidden",
  );
  const labels = names.map((name) => [name, scene.maps.get(name).layer.label]);
  if (scene.colour) labels.push(["colour", "Colour"]);
  $("colours").replaceChildren(
    ...labels.map(([name, label], at) => {
      const button = Object.assign(document.createElement("button"), {
        type: "button",
        textContent: label,
        title: `Key ${at + 1}`,
      });
      button.dataset.layer = name;
      button.addEventListener("click", () => show(name));
      return button;
    }),
  );
  $("space").setAttribute(
    "aria-label",
    `${shown} in space, ${size}. Arrow keys turn, Enter picks what is in the middle.`,
  );
  home();
  show(
    scene.colour ? "colour" : scene.numbers.uncertainty && !scene.mesh ? "uncertainty" : "height",
  );
  readout();
}

async function main() {
  renderer = new PointRenderer();
  renderer.lost = () => say("The graphics unit was lost; reload the page.");
  context = $("space").getContext("2d");
  for (const [kind, name] of Object.entries(MAP_OF)) state.tables[kind] = table(name);
  state.tables.hidden = state.tables.range;
  colours = themed(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  state.record = new MeasurementRecord(state, () => {
    listed();
    redraw();
  });
  wired();
  await opened();
  state.record.open(state.scene.name);
  document.documentElement.dataset.complete = "yes";
}

state.views = { camera, seenBy, seenAt, turned };
window.amulor = state;
main().catch(failed);
