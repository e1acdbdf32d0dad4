// Compiled program of the graphics card, with the locations of its uniforms.

/**
 * Return a program of two shaders, and the locations of its uniforms.
 * @param {WebGL2RenderingContext} gl
 * @param {{vertex: string, fragment: string, captured?: string[]}} sources with the names of
 * vertex outputs that go to a buffer
 */
export function program(gl, { vertex, fragment, captured = [] }) {
  const made = gl.createProgram();
  const shaders = [
    { kind: gl.VERTEX_SHADER, text: vertex },
    { kind: gl.FRAGMENT_SHADER, text: fragment },
  ].map(({ kind, text }) => {
    // Null if the graphics context was lost, which a separate event reports.
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
    return shader;
  });
  if (captured.length) gl.transformFeedbackVaryings(made, captured, gl.INTERLEAVED_ATTRIBS);
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) {
    const logs = shaders.map((shader) => gl.getShaderInfoLog(shader));
    throw new Error(
      `The GPU refuses a program: ${[gl.getProgramInfoLog(made), ...logs].join(" ")}`,
    );
  }
  /** @type {Record<string, WebGLUniformLocation | null>} */
  const places = {};
  const count = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS);
  for (let k = 0; k < count; k += 1) {
    const name = gl.getActiveUniform(made, k)?.name ?? "";
    places[name] = gl.getUniformLocation(made, name);
  }
  return { made, places };
}
