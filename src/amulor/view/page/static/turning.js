// Control of a 3D view: drag rotates, Shift or two fingers move, the wheel zooms.

/** @typedef {(event: PointerEvent) => void} Pull */
/** @typedef {{x: number, y: number, moved: number, pull?: Pull | null}} Pointer */
/**
 * Functions called after a motion of the view, a hover, a pick and a double click.
 * @typedef {object} Acts
 * @property {() => void} moved
 * @property {(event: PointerEvent) => void} hover
 * @property {(event: PointerEvent) => void} pick
 * @property {() => void} home
 * @property {(event: PointerEvent) => ((event: PointerEvent) => void) | null} [grab] a part of the
 * view under the pointer, which the pointer then moves
 */

/** Time after the last motion during which a view counts as moving [ms]. */
const REST = 180;

/** State of motion of a view, so that fewer points are drawn during motion. */
export class Motion {
  #count = 0;
  #changed;

  /**
   * @param {() => void} changed
   */
  constructor(changed) {
    this.#changed = changed;
  }

  get busy() {
    return this.#count > 0;
  }

  /** Report a motion of the view; it is drawn now, and again at rest. */
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

/** Drawing times in motion above which fewer points are drawn, below which more [ms]. Without a
GPU the browser needs about as long again to compose the page. */
const SLOW = 40;
const FAST = 18;

/** Number of points that a moving view draws, adapted to the time of its frames. */
export class Pace {
  #waiting = false;
  #fewest;
  #most;

  /**
   * @param {number} start
   * @param {{fewest: number, most: number}} limits
   */
  constructor(start, { fewest, most }) {
    this.count = start;
    this.#fewest = fewest;
    this.#most = most;
  }

  /**
   * Measure the frame that was just given to the graphics card, which draws it later.
   * @param {WebGL2RenderingContext} gl
   */
  measure(gl) {
    if (this.#waiting) return;
    const began = performance.now();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (!fence) return;
    this.#waiting = true;
    gl.flush();
    const poll = () => {
      const pending = gl.getSyncParameter(fence, gl.SYNC_STATUS) === gl.UNSIGNALED;
      if (pending && !gl.isContextLost()) {
        setTimeout(poll, 4);
        return;
      }
      gl.deleteSync(fence);
      this.#waiting = false;
      this.paced(performance.now() - began);
    };
    setTimeout(poll, 4);
  }

  /**
   * Draw fewer points after a slow frame, more after a fast one.
   * @param {number} time [ms]
   */
  paced(time) {
    if (time > SLOW) this.count = Math.max(this.count * (SLOW / time), this.#fewest);
    else if (time < FAST) this.count = Math.min(this.count * 1.5, this.#most);
  }
}

/**
 * Connect pointer events on a canvas to a camera; a click without dragging picks.
 * @param {HTMLCanvasElement} canvas
 * @param {import("./camera.js").Camera} camera
 * @param {Acts} acts
 */
export function turnable(canvas, camera, { moved, hover, pick, home, grab }) {
  /** @type {Map<number, Pointer>} */
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
    const { pointerId, clientX, clientY } = event;
    canvas.setPointerCapture(pointerId);
    pointers.set(pointerId, { x: clientX, y: clientY, moved: 0, pull: grab?.(event) });
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return hover(event);
    if (pointer.pull) return pointer.pull(event);
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    dragged(camera, pointer, other, event, canvas.clientHeight);
    return moved();
  });
  canvas.addEventListener("pointercancel", ({ pointerId }) => pointers.delete(pointerId));
  canvas.addEventListener("pointerup", (event) => {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    if (pointer && !pointer.pull && pointer.moved < 6) pick(event);
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => {
    home();
    moved();
  });
}

/**
 * @param {import("./camera.js").Camera} camera
 * @param {Pointer} pointer
 * @param {Pointer | undefined} other
 * @param {PointerEvent} event
 * @param {number} tall
 */
function dragged(camera, pointer, other, event, tall) {
  const [dx, dy] = [event.clientX - pointer.x, event.clientY - pointer.y];
  pointer.moved += Math.abs(dx) + Math.abs(dy);
  if (other) {
    const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
    const after = Math.hypot(event.clientX - other.x, event.clientY - other.y);
    camera.zoom(Math.max(before, 1) / Math.max(after, 1));
    camera.pan(dx / 2 / tall, dy / 2 / tall);
  } else if (event.shiftKey || event.buttons & 6) camera.pan(dx / tall, dy / tall);
  else camera.orbit((dx / tall) * 3.2, (dy / tall) * 3.2);
  pointer.x = event.clientX;
  pointer.y = event.clientY;
}
