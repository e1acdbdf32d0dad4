// Elements of a page: found by name, and made.

/** Return an element of the page by its name. */
export const $ = (id) => document.getElementById(id);

/** Return a new element with properties and children. */
export function made(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Return the pixels of a canvas for each pixel of the page. */
export function ratioOf(canvas) {
  return canvas.width / Math.max(canvas.clientWidth, 1);
}

/** Return where a pointer is on a canvas, in the canvas' own pixels. */
export function spotOn(canvas, event) {
  const box = canvas.getBoundingClientRect();
  const ratio = canvas.width / box.width;
  return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
}
