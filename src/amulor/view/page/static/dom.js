// Elements of a page: look-up by name, and creation.

/**
 * Return an element of the page by its name. tsc cannot read its type from the HTML.
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
 * Return the drawing context of a canvas. Each canvas is a layer that the browser composes for
 * every frame: an opaque layer costs less, and a plot, which rarely changes, needs none.
 * @param {HTMLCanvasElement} canvas
 * @param {{opaque?: boolean, plot?: boolean}} [kind]
 */
export function inkOf(canvas, { opaque = false, plot = false } = {}) {
  const kind = { alpha: !opaque, willReadFrequently: plot };
  return /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", kind));
}

/**
 * Return a new canvas over another one, for overlays that follow the pointer.
 * @param {HTMLCanvasElement} canvas
 */
export function over(canvas) {
  const layer = made("canvas", { className: "over", ariaHidden: "true" });
  canvas.after(layer);
  return layer;
}

/**
 * Return the number of canvas pixels per page pixel; drawings for paper state it.
 * @param {HTMLCanvasElement} canvas
 */
export function ratioOf(canvas) {
  return Number(canvas.dataset.ratio) || canvas.width / Math.max(canvas.clientWidth, 1);
}

/**
 * Return the position of the pointer on a canvas [canvas pixel].
 * @param {HTMLCanvasElement} canvas
 * @param {{clientX: number, clientY: number}} event
 * @returns {[number, number]}
 */
export function spotOn(canvas, event) {
  const box = canvas.getBoundingClientRect();
  const ratio = canvas.width / box.width;
  return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
}
