// Drawing of points and triangles; edges darken the points behind them.

import { program } from "./program.js";

const COLOUR = `
uniform sampler2D uTable;
uniform vec2 uLimits;
uniform int uKind;            // 0 numbers, 1 flags, 2 the file's own colors
uniform vec3 uMissing;
vec3 coloured(float value, vec3 own) {
  if (uKind == 2) return own;
  if (uKind == 1) return texelFetch(uTable, ivec2(int(value + 0.5), 0), 0).rgb;
  if (!(value == value) || abs(value) > 1e30) return uMissing;
  float share = (value - uLimits.x) / max(uLimits.y - uLimits.x, 1e-30);
  return texelFetch(uTable, ivec2(int(clamp(share, 0.0, 1.0) * 255.0 + 0.5), 0), 0).rgb;
}
`;
const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
`;

const SHAPE = {
  vertex: `${HEAD}${COLOUR}
layout(location = 0) in vec3 aPlace;
layout(location = 1) in float aValue;
layout(location = 2) in vec3 aOwn;
uniform mat4 uProject;
uniform float uDot;           // size of a point, times its distance if far ones shrink
uniform bool uShrinks;
out vec3 vColour;
out vec3 vPlace;
void main() {
  gl_Position = uProject * vec4(aPlace, 1.0);
  gl_PointSize = clamp(uShrinks ? uDot / max(gl_Position.w, 1e-6) : uDot, 1.5, 64.0);
  vColour = coloured(aValue, aOwn);
  vPlace = aPlace;
}`,
  fragment: `${HEAD}
in vec3 vColour;
in vec3 vPlace;
uniform bool uSurface;
uniform vec3 uLight;          // towards the light
uniform vec3 uForward;        // away from the eye
out vec4 colour;
void main() {
  float lit = 1.0;
  if (uSurface) {
    vec3 n = cross(dFdx(vPlace), dFdy(vPlace));
    n = dot(n, n) > 0.0 ? normalize(n) : -uForward;
    if (dot(n, uForward) > 0.0) n = -n;
    lit = 0.34 + 0.76 * max(dot(n, uLight), 0.0);
  } else {
    vec2 off = gl_PointCoord - 0.5;
    if (dot(off, off) > 0.25) discard;
  }
  colour = vec4(vColour * lit, 1.0);
}`,
};

const EDGES = {
  vertex: `${HEAD}
void main() { gl_Position = vec4(vec2(float(gl_VertexID & 1), float(gl_VertexID >> 1)) * 2.0 - 1.0, 0.0, 1.0); }`,
  fragment: `${HEAD}
uniform sampler2D uPicture;
uniform sampler2D uDepth;
uniform vec2 uPlanes;         // near, far [m]
uniform bool uShrinks;
uniform float uStep;          // a step in depth that is drawn as dark as can be [m]
uniform float uReach;         // distance of the neighbors [pixel]
uniform ivec2 uSize;
out vec4 colour;
float away(ivec2 at) {
  float d = texelFetch(uDepth, clamp(at, ivec2(0), uSize - 1), 0).r;
  if (d >= 1.0) return 1e9;
  return uShrinks ? uPlanes.x * uPlanes.y / (uPlanes.y - d * (uPlanes.y - uPlanes.x)) : mix(uPlanes.x, uPlanes.y, d);
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 c = texelFetch(uPicture, at, 0);
  float own = away(at);
  if (own < 1e8 && uStep > 0.0) {
    float dark = 0.0;
    for (int k = 0; k < 8; k += 1) {
      float angle = 0.7853981634 * float(k);
      float other = away(at + ivec2(round(uReach * vec2(cos(angle), sin(angle)))));
      dark += clamp((own - other) / uStep, 0.0, 1.0);
    }
    c.rgb *= exp(-0.22 * dark);
  }
  colour = c;
}`,
};

/** Points or triangles on the graphics card. */
export class PointRenderer {
  /** Points, and the corners of triangles if there are any. */
  count = 0;
  corners = 0;

  constructor() {
    this.canvas = document.createElement("canvas");
    const gl = this.canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl)
      throw new Error(
        "This browser has no WebGL 2, which draws the points. Allow it, or take a newer browser.",
      );
    this.gl = gl;
    this.lost = () => {};
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.lost();
    });
    this.shape = program(gl, SHAPE);
    this.edges = program(gl, EDGES);
    this.array = gl.createVertexArray();
    this.buffers = [0, 1, 2].map(() => gl.createBuffer());
    this.index = gl.createBuffer();
    this.frame = gl.createFramebuffer();
    this.targets = [gl.createTexture(), gl.createTexture()];
    this.table = gl.createTexture();
  }

  /** Store positions, and the corners of triangles if there are any. */
  keep(position, faces) {
    const { gl } = this;
    gl.bindVertexArray(this.array);
    this.#filled(0, position, 3, gl.FLOAT, false);
    this.count = position.length / 3;
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, faces ? this.index : null);
    if (faces) gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    this.corners = faces ? faces.length : 0;
  }

  /** Store the values that are shown as colors. */
  numbers(values) {
    this.gl.bindVertexArray(this.array);
    this.#filled(1, values, 1, this.gl.FLOAT, false);
  }

  /** Store the colors of the file. */
  own(colours) {
    this.gl.bindVertexArray(this.array);
    this.#filled(2, colours, 3, this.gl.UNSIGNED_BYTE, true);
  }

  #filled(place, values, parts, kind, scaled) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[place]);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, parts, kind, scaled, 0, 0);
  }

  colours(bytes) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    this.#plain();
  }

  #plain() {
    const { gl } = this;
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
      gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const scale of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER])
      gl.texParameteri(gl.TEXTURE_2D, scale, gl.NEAREST);
  }

  #sized(width, height) {
    const { gl } = this;
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    const [picture, depth] = this.targets;
    gl.bindTexture(gl.TEXTURE_2D, picture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
    this.#plain();
    gl.bindTexture(gl.TEXTURE_2D, depth);
    gl.texImage2D(
      gl.TEXTURE_2D,
      0,
      gl.DEPTH_COMPONENT24,
      width,
      height,
      0,
      gl.DEPTH_COMPONENT,
      gl.UNSIGNED_INT,
      null,
    );
    this.#plain();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE)
      throw new Error("The GPU has no room for a picture of this size.");
  }

  /** Draw on a canvas; while the view moves, at most `most` points. */
  draw(
    context,
    {
      matrix,
      planes,
      shrinks,
      dot,
      kind,
      limits,
      missing,
      ground,
      light,
      forward,
      step,
      reach,
      most,
    },
  ) {
    const { gl } = this;
    const { width, height } = context.canvas;
    this.#sized(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(ground[0], ground[1], ground[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { made, places } = this.shape;
    gl.useProgram(made);
    gl.bindVertexArray(this.array);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    gl.uniform1i(places.uTable, 0);
    gl.uniform1i(places.uKind, kind);
    gl.uniform2fv(places.uLimits, limits);
    gl.uniform3fv(places.uMissing, missing);
    gl.uniform1i(places.uSurface, this.corners ? 1 : 0);
    gl.uniform3fv(places.uLight, light);
    gl.uniform3fv(places.uForward, forward);
    gl.uniformMatrix4fv(places.uProject, false, matrix);
    gl.uniform1f(places.uDot, dot);
    gl.uniform1i(places.uShrinks, shrinks ? 1 : 0);
    if (this.corners) gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(gl.POINTS, 0, Math.min(this.count, most));
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    this.#edged({ planes, shrinks, step, reach, width, height });
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.canvas, 0, 0);
  }

  #edged({ planes, shrinks, step, reach, width, height }) {
    const { gl } = this;
    const { made, places } = this.edges;
    gl.useProgram(made);
    this.targets.forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.uniform1i(unit ? places.uDepth : places.uPicture, unit);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform2fv(places.uPlanes, planes);
    gl.uniform1i(places.uShrinks, shrinks ? 1 : 0);
    gl.uniform1f(places.uStep, step);
    gl.uniform1f(places.uReach, reach);
    gl.uniform2i(places.uSize, width, height);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }
}
