// Live view of a running scan: new rows, state and advice.

import { $, inkOf } from "./dom.js";
import { fitted } from "./map.js";
import { Traces } from "./traces.js";
import { clockIn, duration, short, ticks } from "./text.js";
import { Vehicle } from "./vehicle.js";

/** Delay before another attempt to reach a lost server [ms]. */
const PAUSES = [500, 1000, 2000, 5000];

function made(tag, className, text = "") {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = text;
  return element;
}

/** Follows the running scan of the server, and replays a finished one. */
export class Live {
  constructor(card, page) {
    this.card = card;
    this.page = page;
    this.tries = 0;
    this.rows = 0;
    this.whole = new Map();
    card.hidden = false;
    const head = made("div", "bar");
    this.state = made("span", "state", "connecting");
    head.append(made("h2", "", "Scan"), this.state);
    this.bar = made("i", "");
    const progress = made("div", "progress");
    progress.role = "progressbar";
    progress.ariaLabel = "Samples taken";
    progress.append(this.bar);
    this.list = document.createElement("dl");
    this.advice = made("div", "");
    this.advice.ariaLive = "polite";
    this.drift = document.createElement("canvas");
    this.drift.setAttribute("role", "img");
    this.replay = made("div", "replay");
    this.replay.hidden = true;
    card.append(head, progress, this.list, this.drift, this.replay, this.advice);
    this.traces = new Traces(page);
    if (page.state.scene.moves) this.vehicle = new Vehicle(page);
    this.#replaying();
    this.#connect();
  }

  #connect() {
    const address = new URL("live", location.href);
    address.protocol = "ws:";
    const socket = new WebSocket(address);
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.page.say("");
      // Rows missed in the meantime come with the maps.
      if (this.tries) this.page.reload().catch((error) => this.page.say(error.message));
      this.tries = 0;
    };
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") this.#rows(data);
      else this.#told(JSON.parse(data));
    };
    socket.onclose = () => {
      this.state.textContent = "connection lost";
      this.state.classList.add("lost");
      $("band").dataset.severity = "lost";
      this.page.say(
        "The connection to the scan is lost; it is tried again by itself. The scan goes on without this page.",
      );
      const pause = PAUSES[Math.min(this.tries, PAUSES.length - 1)];
      this.tries += 1;
      setTimeout(() => this.#connect(), pause);
    };
  }

  #told(message) {
    if (message.type === "picture") {
      // New rows wait for the maps, which would overwrite them.
      this.loads = (this.loads ?? 0) + 1;
      this.held ??= [];
      this.page
        .reload()
        .finally(() => {
          this.loads -= 1;
          if (this.loads) return;
          const { held } = this;
          this.held = null;
          for (const buffer of held) this.#rows(buffer);
        })
        .then(
          () => {
            this.pictures = (this.pictures ?? 0) + 1;
            document.documentElement.dataset.pictures = String(this.pictures);
          },
          (error) => this.page.say(error.message),
        );
    } else if (message.type === "status") {
      this.status = message;
      this.draw();
    }
  }

  #rows(buffer) {
    if (this.held) {
      this.held.push(buffer);
      return;
    }
    const size = new DataView(buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
    const { scene } = this.page.state;
    if (head.channel !== scene.channel || head.row % scene.stride) return;
    const wide = scene.columns;
    head.layers.forEach((name, k) => {
      const values = new Float32Array(buffer, 4 + size + 4 * k * wide, wide);
      scene.patch(
        name,
        head.row / scene.stride,
        scene.stride > 1 ? values.filter((_, at) => at % scene.stride === 0) : values,
      );
    });
    for (const name of ["range", "range_before"]) if (scene.maps.has(name)) scene.smooth(name);
    this.rows += 1;
    document.documentElement.dataset.rows = String(this.rows);
    this.page.refresh();
  }

  draw() {
    const { status } = this;
    if (status?.error) this.page.say(status.error);
    else if (this.error) this.page.unsay(this.error);
    this.error = status?.error;
    if (status?.state === undefined) return;
    const colours = this.page.colours();
    this.state.textContent =
      status.state === "running" ? `taking ${status.kind || "the first sample"}` : status.state;
    this.state.classList.toggle("lost", Boolean(status.error ?? status.resume));
    if (status.state === "running" && status.row !== null) this.page.follow(status.row);
    const share = status.done / Math.max(status.total, 1);
    this.bar.style.width = `${100 * share}%`;
    this.bar.parentElement.ariaValueNow = String(Math.round(100 * share));
    const flagged = Object.entries(status.flagged);
    const rows = [["samples", `${status.done} of ${status.total} (${(100 * share).toFixed(0)} %)`]];
    if (status.rate !== null) rows.push(["rate", `${short(status.rate, 3)} a second`]);
    if (status.left !== null) rows.push(["time left", duration(status.left)]);
    rows.push(["scan time", duration(status.elapsed)]);
    for (const [name, count] of flagged)
      rows.push([name, `${count} (${short((100 * count) / status.done, 2)} %)`]);
    this.list.replaceChildren(
      ...rows.flatMap(([term, text]) => [made("dt", "", term), made("dd", "", text)]),
    );
    this.#advise(status);
    this.#band(status, share);
    this.#drift(status.drift, colours);
    this.traces.update(status.done);
    this.vehicle?.update(status.coverage);
    this.vehicle?.draw();
    this.replay.hidden = status.state !== "finished";
    document.documentElement.dataset.done = String(status.done);
    document.documentElement.dataset.state = status.state;
  }

  /** State, progress, end and the first advice across the top; progress in the tab's title. */
  #band({ state, left, advice, resume, error }, share) {
    const band = $("band");
    band.hidden = false;
    band.dataset.severity = error || resume ? "lost" : advice.length ? "advice" : "";
    const percent = `${Math.floor(100 * share)} %`;
    const bar = document.createElement("progress");
    Object.assign(bar, { max: 1, value: share, ariaLabel: "Scan done" });
    const parts = [made("strong", "", this.state.textContent), bar, made("span", "", percent)];
    if (left !== null) parts.push(made("span", "end", `ends ${clockIn(left, new Date())}`));
    const [first] = advice;
    if (first) parts.push(made("span", "advice", `${first[0].toUpperCase()}${first.slice(1)}.`));
    // Screen readers read a status when it is written; it is written only if it changes.
    const words = parts.map((part) => part.textContent).join();
    if (words !== this.words) band.replaceChildren(...parts);
    this.words = words;
    const title = this.page.state.scene.title;
    document.title = `${state === "running" ? `${percent} · ` : `${state} · `}${title} · amulor`;
  }

  #advise({ advice, resume }) {
    const said = advice.map((text) => text[0].toUpperCase() + text.slice(1));
    // Unchanged content stays, so that a command in it can be selected and copied.
    if (this.said === said.join("\n")) return;
    this.said = said.join("\n");
    this.advice.replaceChildren(
      ...said.map((text) => {
        if (!resume || !text.endsWith(resume)) return made("div", "advice", `${text}.`);
        const line = made("div", "advice", text.slice(0, -resume.length));
        line.append(made("code", "", resume));
        return line;
      }),
    );
  }

  #drift({ elapsed, change, error, total }, colours) {
    this.drift.hidden = change.length < 2;
    if (this.drift.hidden) return;
    fitted(this.drift);
    const ctx = inkOf(this.drift, { plot: true });
    const ratio = this.drift.width / this.drift.clientWidth;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const [width, height] = [this.drift.clientWidth, this.drift.clientHeight];
    ctx.clearRect(0, 0, width, height);
    const most =
      Math.max(0.01, ...change.map((value, k) => Math.abs(value) + Math.min(error[k] ?? 0, 0.2))) *
      1.15;
    ctx.font = `12px ${colours.font}`;
    // Five parts of an interval about zero give at least one tick on either side.
    const marks = ticks(-most, most, 5).values.map((value) => [
      value,
      `${value > 0 ? "+" : ""}${short(100 * value, 2)} %`,
    ]);
    const margin = Math.max(...marks.map(([, text]) => ctx.measureText(text).width)) + 8;
    const span = Math.max(elapsed.at(-1) - elapsed[0], 1e-9);
    const x = (time) => margin + 4 + ((time - elapsed[0]) / span) * (width - margin - 10);
    const y = (value) => (height + 12) / 2 - (value / most) * ((height - 24) / 2);
    ctx.textBaseline = "middle";
    ctx.fillStyle = colours.soft;
    ctx.textAlign = "left";
    const size = `${total.size > 0 ? "+" : ""}${(100 * total.size).toFixed(1).replace("-", "−")}`;
    ctx.fillText(`open water by rounds, in all ${size} ± ${short(100 * total.error, 2)} %`, 0, 6);
    ctx.textAlign = "right";
    ctx.strokeStyle = colours.line;
    for (const [value, text] of marks) {
      ctx.fillText(text, margin - 4, y(value));
      ctx.beginPath();
      ctx.moveTo(margin, y(value));
      ctx.lineTo(width, y(value));
      ctx.stroke();
    }
    ctx.strokeStyle = ctx.fillStyle = colours.accent;
    change.forEach((value, k) => {
      ctx.beginPath();
      ctx.arc(x(elapsed[k]), y(value), 3, 0, 7);
      ctx.fill();
      if (error[k] === null) return;
      ctx.beginPath();
      ctx.moveTo(x(elapsed[k]), y(value - error[k]));
      ctx.lineTo(x(elapsed[k]), y(value + error[k]));
      ctx.stroke();
    });
    this.drift.setAttribute(
      "aria-label",
      `Open water changed by ${size} percent from the first shots to the last`,
    );
  }

  /** Replay of a finished scan, from the first pixel to the last. */
  #replaying() {
    const play = made("button", "mini", "replay");
    play.type = "button";
    const slider = document.createElement("input");
    slider.type = "range";
    slider.min = "0";
    slider.max = "1000";
    slider.value = "1000";
    slider.ariaLabel = "Time of the scan";
    let timer = 0;
    const stop = () => {
      clearInterval(timer);
      timer = 0;
      play.textContent = "replay";
    };
    slider.addEventListener("input", () => this.#until(Number(slider.value) / 1000));
    play.addEventListener("click", () => {
      if (timer) return stop();
      if (slider.value === "1000") slider.value = "0";
      play.textContent = "pause";
      timer = setInterval(() => {
        slider.value = String(Number(slider.value) + 8);
        this.#until(Number(slider.value) / 1000).catch(stop);
        if (slider.value === "1000") stop();
      }, 80);
      return undefined;
    });
    this.replay.append(play, slider);
  }

  async #until(share) {
    const { scene } = this.page.state;
    const { values: time } = await scene.load("time");
    const known = time.filter(Number.isFinite);
    const first = known.reduce((a, b) => Math.min(a, b), Infinity);
    const last = known.reduce((a, b) => Math.max(a, b), -Infinity);
    const limit = first + share * (last - first);
    this.traces.until = share >= 1 ? null : limit;
    for (const [name, map] of scene.maps) {
      if (name === "time" || map.layer.kind === "hidden") continue;
      map.all ??= map.values.slice();
      const missing = map.layer.kind === "flags" ? 1 : NaN;
      map.values = map.all.map((value, at) => (share >= 1 || time[at] <= limit ? value : missing));
      scene.upload(name);
    }
    document.documentElement.dataset.replayed = String(share);
    this.page.refresh();
  }
}
