// Turning a view in space: drag turns, Shift or two fingers move, the wheel zooms.

/** How long a view counts as moving after its last move [ms]. */
const REST = 180;

/** Tells whether a view moves, so that fewer points are drawn meanwhile. */
export class Motion {
  #count = 0;
  #changed;

  constructor(changed) {
    this.#changed = changed;
  }

  get busy() {
    return this.#count > 0;
  }

  /** Say that the view has moved; it is drawn now, and once more at rest. */
  moved() {
    this.#count += 1;
    const now = this.#count;
    this.#changed();
    setTimeout(() => {
      if (this.#count !== now) return;
      this.#count = 0;
      this.#changed();
    }, REST);
  }
}

/** Let pointers on a canvas move a camera; they pick where they are not dragged. */
export function turnable(canvas, camera, { moved, hover, pick, home }) {
  const pointers = new Map();
  const wheel = (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(event.deltaY * 0.0013));
    moved();
  };
  canvas.addEventListener("wheel", wheel, { passive: false });
  canvas.addEventListener("pointerdown", ({ pointerId, clientX, clientY }) => {
    canvas.setPointerCapture(pointerId);
    pointers.set(pointerId, { x: clientX, y: clientY, moved: 0 });
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return hover(event);
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    dragged(camera, pointer, other, event, canvas.clientHeight);
    return moved();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      const pointer = pointers.get(event.pointerId);
      pointers.delete(event.pointerId);
      if (pointer && pointer.moved < 6 && name === "pointerup") pick(event);
    });
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => {
    home();
    moved();
  });
}

function dragged(camera, pointer, other, event, tall) {
  const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y];
  pointer.moved += Math.abs(dx) + Math.abs(dy);
  if (other) {
    const span = (x, y) => Math.max(Math.hypot(x - other.x, y - other.y), 1);
    camera.zoom(span(pointer.x, pointer.y) / span(event.clientX, event.clientY));
    camera.pan(dx / 2 / tall, dy / 2 / tall);
  } else if (event.shiftKey || event.buttons & 6) camera.pan(dx / tall, dy / tall);
  else camera.orbit((dx / tall) * 3.2, (dy / tall) * 3.2);
  pointer.x = event.clientX;
  pointer.y = event.clientY;
}
