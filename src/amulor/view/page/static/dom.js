// Elements of a page: found by name, and made.

/**
 * Return an element of the page by its name. Its kind stands in the HTML, which tsc does not read.
 * @type {(id: string) => any}
 */
export const $ = (id) => document.getElementById(id);

/**
 * Return a new element with properties and children.
 * @template {keyof HTMLElementTagNameMap} Tag
 * @param {Tag} tag
 * @param {Record<string, unknown>} [properties]
 * @param {(Node | string)[]} children
 * @returns {HTMLElementTagNameMap[Tag]}
 */
export function made(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/**
 * Return what draws on a canvas.
 * @param {HTMLCanvasElement} canvas
 */
export function inkOf(canvas) {
  return /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
}

/**
 * Return a new canvas over another one, for what moves with the pointer.
 * @param {HTMLCanvasElement} canvas
 */
export function over(canvas) {
  const layer = made("canvas", { className: "over", ariaHidden: "true" });
  canvas.after(layer);
  return layer;
}

/**
 * Return the pixels of a canvas for each pixel of the page.
 * @param {HTMLCanvasElement} canvas
 */
export function ratioOf(canvas) {
  return canvas.width / Math.max(canvas.clientWidth, 1);
}

/**
 * Return where a pointer is on a canvas, in the canvas' own pixels.
 * @param {HTMLCanvasElement} canvas
 * @param {{clientX: number, clientY: number}} event
 * @returns {[number, number]}
 */
export function spotOn(canvas, event) {
  const box = canvas.getBoundingClientRect();
  const ratio = canvas.width / box.width;
  return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
}
