// One graphics context for all views, so that textures are stored once.

import { program } from "./program.js";
import { MAP, NODES, SPACE } from "./shaders.js";

/** Bytes of a node: three coordinates, and a color in four bytes. */
const NODE = 16;

/** Renderer of maps and clouds on any canvas. */
export class Renderer {
  /** Key of the nodes on the graphics card, and their number. */
  #nodes = { key: "", count: 0 };
  /** Key of the index buffers on the graphics card, and these by stride. */
  #drawn = { key: "", parts: new Map() };

  constructor() {
    this.canvas = document.createElement("canvas");
    const gl = this.canvas.getContext("webgl2", {
      antialias: false,
      depth: true,
      preserveDrawingBuffer: true,
    });
    if (!gl)
      throw new Error(
        "This browser has no WebGL 2, which draws the maps. Allow it, or take a newer browser.",
      );
    this.gl = gl;
    this.lost = () => {};
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.lost();
    });
    this.map = program(gl, MAP);
    this.nodes = program(gl, NODES);
    this.space = program(gl, SPACE);
    this.plain = gl.createVertexArray();
    this.grid = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    gl.bindVertexArray(this.grid);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, NODE, 0);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, NODE, 12);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
    gl.bindVertexArray(this.plain);
    this.longest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.textures = new Map();
  }

  /** Store values as a texture, by name. */
  keep(name, width, height, values, parts = 1) {
    const { gl } = this;
    const formats = { 1: [gl.R32F, gl.RED], 2: [gl.RG32F, gl.RG], 4: [gl.RGBA32F, gl.RGBA] };
    if (Math.max(width, height) > this.longest)
      throw new Error(
        `The GPU takes ${this.longest} pixels a side, not ${Math.max(width, height)}.`,
      );
    let texture = this.textures.get(name);
    if (!texture) {
      texture = gl.createTexture();
      this.textures.set(name, texture);
    }
    gl.bindTexture(gl.TEXTURE_2D, texture);
    this.#plain();
    const bytes = values instanceof Uint8Array;
    const [inner, outer] = bytes ? [gl.RGBA8, gl.RGBA] : formats[parts];
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(
      gl.TEXTURE_2D,
      0,
      inner,
      width,
      height,
      0,
      outer,
      bytes ? gl.UNSIGNED_BYTE : gl.FLOAT,
      values,
    );
    return texture;
  }

  /** Replace some rows of a texture. */
  rows(name, first, count, width, values) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.textures.get(name));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, first, width, count, gl.RED, gl.FLOAT, values);
  }

  #plain() {
    const { gl } = this;
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
      gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const scale of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, scale, gl.NEAREST);
  }

  #use({ made, places }, textures, set) {
    const { gl } = this;
    gl.useProgram(made);
    Object.entries(textures).forEach(([uniform, name], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, this.textures.get(name) ?? null);
      gl.uniform1i(places[uniform] ?? null, unit);
    });
    gl.activeTexture(gl.TEXTURE0);
    for (const [name, [kind, ...values]] of Object.entries(set)) {
      if (places[name] !== undefined) gl[`uniform${kind}`](places[name], ...values);
    }
  }

  #sized(width, height) {
    // The size never shrinks, because a change allocates a new buffer.
    if (this.canvas.width < width || this.canvas.height < height) {
      this.canvas.width = Math.max(this.canvas.width, width);
      this.canvas.height = Math.max(this.canvas.height, height);
    }
    // Drawing uses the lower left part of the buffer.
    this.gl.viewport(0, 0, width, height);
    this.gl.scissor(0, 0, width, height);
    this.gl.enable(this.gl.SCISSOR_TEST);
  }

  /** Copy the last drawing to the context of a canvas. */
  #copied(context, width, height) {
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(
      this.canvas,
      0,
      this.canvas.height - height,
      width,
      height,
      0,
      0,
      width,
      height,
    );
  }

  /** Draw a map. */
  drawMap(context, { layer, table, set, textures }) {
    const { gl } = this;
    const { width, height } = context.canvas;
    this.#sized(width, height);
    gl.disable(gl.DEPTH_TEST);
    this.#use(
      this.map,
      { ...textures, uLayer: layer, uTable: table },
      { ...set, uHeight: ["1f", height] },
    );
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    this.#copied(context, width, height);
  }

  /** Compute places and colors of the nodes, unless the card has those of this key. */
  #placed({ layer, table, set, textures, key, count }) {
    const { gl } = this;
    if (this.#nodes.key === key) return;
    if (this.#nodes.count !== count) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, count * NODE, gl.DYNAMIC_COPY);
      gl.bindBuffer(gl.ARRAY_BUFFER, null);
    }
    this.#use(this.nodes, { ...textures, uLayer: layer, uTable: table }, set);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, this.buffer);
    gl.enable(gl.RASTERIZER_DISCARD);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, count);
    gl.endTransformFeedback();
    gl.disable(gl.RASTERIZER_DISCARD);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
    this.#nodes = { key, count };
  }

  /** Draw nodes by their numbers, which are computed once for a shape and a name. */
  #indexed(mode, shape, name, numbers) {
    const { gl } = this;
    if (this.#drawn.key !== shape) {
      for (const { buffer } of this.#drawn.parts.values()) gl.deleteBuffer(buffer);
      this.#drawn = { key: shape, parts: new Map() };
    }
    const { parts } = this.#drawn;
    if (!parts.has(name)) {
      const all = numbers();
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, all, gl.STATIC_DRAW);
      parts.set(name, { buffer, count: all.length });
    }
    const { buffer, count } = parts.get(name);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    if (count) gl.drawElements(mode, count, gl.UNSIGNED_INT, 0);
  }

  /** Draw parts of the nodes: triangles and points; with `pick`, return the number of the node
  at a position, or -1. */
  drawCloud(context, { nodes, shape, parts, set, ground, pick }) {
    const { gl } = this;
    const { width, height } = context.canvas;
    this.#placed(nodes);
    this.#sized(width, height);
    gl.enable(gl.DEPTH_TEST);
    const [red, green, blue, cover] = pick ? [0, 0, 0, 0] : [...ground, 1];
    gl.clearColor(red, green, blue, cover);
    if (pick) gl.scissor(Math.max(pick.x - 6, 0), Math.max(height - pick.y - 7, 0), 13, 13);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.#use(this.space, {}, { ...set, uPick: ["1i", pick ? 1 : 0] });
    gl.bindVertexArray(this.grid);
    for (const { mode, name, numbers } of parts)
      this.#indexed(mode === "points" ? gl.POINTS : gl.TRIANGLES, shape, name, numbers);
    gl.bindVertexArray(this.plain);
    if (!pick) {
      this.#copied(context, width, height);
      return -1;
    }
    return this.#nearest(pick, height);
  }

  #nearest({ x, y }, height) {
    const { gl } = this;
    const left = Math.max(x - 6, 0);
    const low = Math.max(height - y - 7, 0);
    const bytes = new Uint8Array(13 * 13 * 4);
    gl.readPixels(left, low, 13, 13, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    let best = -1;
    let least = Infinity;
    for (let j = 0; j < 13; j += 1) {
      for (let i = 0; i < 13; i += 1) {
        const at = 4 * (j * 13 + i);
        const id =
          bytes[at] + bytes[at + 1] * 256 + bytes[at + 2] * 65536 + bytes[at + 3] * 16777216;
        const away = (left + i - x) ** 2 + (low + j - (height - y - 1)) ** 2;
        if (id > 0 && away < least) {
          least = away;
          best = id - 1;
        }
      }
    }
    return best;
  }
}
