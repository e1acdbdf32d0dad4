// Source of the data: the server on this computer, or the page itself.

/** Source that queries the server of the page. */
class Served {
  saved = false;

  async #answer(address, options) {
    let response;
    try {
      response = await fetch(address, { cache: "no-store", ...options });
    } catch {
      throw new Error(
        "The server does not answer. Start amulor view again, and open its new address.",
      );
    }
    if (!response.ok) {
      const said = await response.json().catch(() => ({}));
      throw new Error(said.error ?? `The server refused this (${response.status}).`);
    }
    return response;
  }

  async scene(channel) {
    const query = channel === undefined ? "" : `?channel=${encodeURIComponent(channel)}`;
    return (await this.#answer(`scene${query}`)).json();
  }

  async bytes(channel, name) {
    const place = `layer/${encodeURIComponent(channel)}/${encodeURIComponent(name)}`;
    return (await this.#answer(place)).arrayBuffer();
  }

  async layer(channel, name, flags) {
    const buffer = await this.bytes(channel, name);
    return flags ? new Uint16Array(buffer) : new Float32Array(buffer);
  }

  async spectrum(channel, row, column) {
    return (await this.#answer(`spectrum/${encodeURIComponent(channel)}/${row}/${column}`)).json();
  }

  /** Return the signals of a running scan over time. */
  async traces(channel, frequency) {
    return (await this.#answer(`traces/${encodeURIComponent(channel)}/${frequency}`)).json();
  }

  /** Return track and coverage of a running scan from a vehicle. */
  async coverage() {
    return (await this.#answer("coverage")).json();
  }

  async measure(request) {
    return (await this.#post("measure", request)).json();
  }

  async page(measurements, limits) {
    return (await this.#post("save", { measurements, limits })).blob();
  }

  async closer(box) {
    return (await this.#post("closer", box)).arrayBuffer();
  }

  /** Return the saved views and annotations. */
  async notes() {
    return (await this.#answer("notes")).json();
  }

  async keepNotes(content) {
    return (await this.#post("notes", content)).json();
  }

  /** Return the digest of the data file; empty without a file. */
  async digest() {
    return (await this.#answer("digest")).json();
  }

  /** Return the products that the server can make. */
  async products() {
    return (await this.#answer("products")).json();
  }

  /** Return a product: file name, description and bytes. */
  async product(request) {
    const answer = await this.#post("product", request);
    const named = /filename\*=UTF-8''([^;]+)/.exec(answer.headers.get("content-disposition") ?? "");
    return {
      name: decodeURIComponent(named?.[1] ?? "product"),
      said: decodeURIComponent(answer.headers.get("amulor-said") ?? ""),
      blob: await answer.blob(),
    };
  }

  #post(address, content) {
    return this.#answer(address, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(content),
    });
  }
}

/** Source that reads data embedded in the page. */
class Saved {
  saved = true;
  #scenes;
  /** @type {Record<string, Float32Array>} */
  #cubes = {};

  constructor(content) {
    this.#scenes = content.scenes;
    this.measurements = content.measurements;
    this.limits = content.limits;
    this.digest = async () => content.digest ?? "";
    this.notes = async () => ({ ...content.notes, file: null });
  }

  async scene(channel) {
    const name = channel ?? Object.keys(this.#scenes)[0];
    return { ...this.#scenes[name], channels: Object.keys(this.#scenes), live: false };
  }

  async layer(channel, name, flags) {
    const bytes = await unpacked(`layer/${channel}/${name}`, flags ? 2 : 4);
    return flags ? new Uint16Array(bytes.buffer) : new Float32Array(bytes.buffer);
  }

  async spectrum(channel, row, column) {
    const scene = this.#scenes[channel];
    /** @type {Record<string, any>} */
    const found = { frequency: scene.frequencies };
    for (const name of ["before", "after"]) {
      if (!element(`spectrum/${channel}/${name}`)) continue;
      const key = `${channel}/${name}`;
      this.#cubes[key] ??= new Float32Array((await unpacked(`spectrum/${key}`, 4)).buffer);
      found[name] = line(this.#cubes[key], scene, row, column);
    }
    if (!found.before && !found.after) return null;
    if (found.before && found.after) found.water = difference(found.before, found.after);
    return found;
  }

  async products() {
    return [];
  }
}

function line(cube, scene, row, column) {
  const count = scene.rows * scene.columns;
  const frequencies = cube.length / count / 3;
  const at = row * scene.columns + column;
  const part = (which, k) => cube[(which * frequencies + k) * count + at];
  const keys = Array.from({ length: frequencies }, (_, k) => k);
  return {
    amplitude: keys.map((k) => Math.hypot(part(0, k), part(1, k))),
    phase: keys.map((k) => Math.atan2(part(1, k), part(0, k))),
    uncertainty: keys.map((k) => part(2, k)),
  };
}

function difference(one, other) {
  const x = one.amplitude.map(
    (a, k) => a * Math.cos(one.phase[k]) - other.amplitude[k] * Math.cos(other.phase[k]),
  );
  const y = one.amplitude.map(
    (a, k) => a * Math.sin(one.phase[k]) - other.amplitude[k] * Math.sin(other.phase[k]),
  );
  return {
    amplitude: x.map((value, k) => Math.hypot(value, y[k])),
    phase: x.map((value, k) => Math.atan2(y[k], value)),
  };
}

function element(name) {
  return document.querySelector(`script[data-name="${CSS.escape(name)}"]`);
}

async function unpacked(name, width) {
  const script = element(name);
  if (!script) throw new Error(`This page does not hold ${name}; it is damaged, save it again.`);
  const text = atob(script.textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at += 1) bytes[at] = text.charCodeAt(at);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const sorted = new Uint8Array(await new Response(stream).arrayBuffer());
  const count = sorted.length / width;
  const out = new Uint8Array(sorted.length);
  for (let k = 0; k < width; k += 1) {
    const from = k * count;
    for (let i = 0; i < count; i += 1) out[i * width + k] = sorted[from + i];
  }
  return out;
}

/** Source of a cloud or mesh: the server, or the page itself. */
export class SpaceSource {
  #served = new Served();

  constructor() {
    const script = element("amulor-scene");
    this.content = script ? JSON.parse(script.textContent) : null;
    this.saved = this.content !== null;
    this.measurements = this.content?.measurements ?? [];
    this.limits = this.content?.limits;
  }

  async scene() {
    return this.saved ? this.content.scenes.space : this.#served.scene();
  }

  /**
   * Return an array by name: floats, integers or bytes.
   * @param {string} name
   * @param {Float32ArrayConstructor | Uint32ArrayConstructor | Uint8ArrayConstructor} [Kind]
   */
  async numbers(name, Kind = Float32Array) {
    const buffer = this.saved
      ? (await unpacked(`layer/space/${name}`, Kind.BYTES_PER_ELEMENT)).buffer
      : await this.#served.bytes("space", name);
    return new Kind(buffer);
  }

  /**
   * Return further points of the file in a box: bytes of their number, positions and values.
   * @param {{low: number[], high: number[]}} box
   */
  closer(box) {
    return this.#served.closer(box);
  }

  page(measurements, limits) {
    return this.#served.page(measurements, limits);
  }

  async notes() {
    return this.saved ? { ...this.content.notes, file: null } : this.#served.notes();
  }

  keepNotes(content) {
    return this.#served.keepNotes(content);
  }
}

/** Return the source of this page. */
export function source() {
  const script = element("amulor-scene");
  return script ? new Saved(JSON.parse(script.textContent)) : new Served();
}
