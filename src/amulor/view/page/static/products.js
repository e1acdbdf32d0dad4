// Products of a scan: selected here, made by the server, downloaded here.

import { made } from "./dom.js";
import { download } from "./picture.js";

/** Options of products: labels and allowed values; lengths in mm. */
const OPTIONS = {
  show: {
    label: "shows",
    choices: [
      ["amplitude", "amplitude"],
      ["height", "height"],
      ["relief", "relief"],
      ["uncertainty", "uncertainty"],
    ],
  },
  side: {
    label: "seen from",
    choices: [
      ["front", "front"],
      ["top", "above"],
    ],
  },
  scale: { label: "scale 1 :", value: 10, least: 0.1, most: 10000 },
  dpi: { label: "dots per inch", value: 300, least: 10, most: 1200 },
  cell: {
    label: "cell [mm]",
    value: "",
    metres: true,
    empty: "by itself",
    least: 0.01,
    most: 1000,
  },
  contours: {
    label: "contours every [mm]",
    value: "",
    metres: true,
    empty: "none",
    least: 0.01,
    most: 10000,
  },
  farthest: {
    label: "largest deviation [mm]",
    value: "",
    metres: true,
    empty: "any",
    least: 0.001,
    most: 1e5,
  },
  axes: {
    label: "axes",
    choices: [
      ["instrument", "instrument: y down"],
      ["z-up", "z up"],
      ["pose", "by the pose: east, north, up"],
    ],
  },
  good_only: { label: "unflagged pixels only", check: true },
  largest_uncertainty: {
    label: "largest uncertainty [mm]",
    value: "",
    metres: true,
    empty: "any",
    least: 1e-6,
    most: 1e5,
  },
};

/** The dialog in which products are ordered. */
export class Products {
  /** @type {any[]} */
  offers = [];
  /** @type {Map<string, any>} */
  inputs = new Map();
  /** What was said before, by the names of options. @type {Record<string, any>} */
  kept = {};
  kind = made("select", { id: "product-kind", ariaLabel: "Product" });
  ending = made("select", { id: "product-ending", ariaLabel: "Format" });
  fields = made("div", { className: "fields" });
  said = made("p", { className: "hint", id: "product-said" });
  make = made("button", {
    type: "button",
    className: "tool",
    id: "product-make",
    textContent: "Make and keep",
  });

  constructor(dialog, page) {
    this.dialog = dialog;
    this.page = page;
  }

  /** Query the available products; return whether there are any. */
  async offered() {
    this.offers = await this.page.source.products();
    if (!this.offers.length) return false;
    this.kind.replaceChildren(
      ...this.offers.map(({ product, label }) => new Option(label, product)),
    );
    this.said.setAttribute("role", "status");
    const close = made("button", { type: "button", className: "tool", textContent: "Close" });
    this.dialog.replaceChildren(
      made("h2", { textContent: "Products" }),
      made("p", {
        textContent: "Made as amulor export makes them, and kept where the browser keeps files.",
      }),
      made("div", { className: "row" }, this.kind, this.ending),
      this.fields,
      this.said,
      made("div", { className: "row" }, this.make, close),
    );
    this.kind.addEventListener("input", () => this.#chosen());
    this.make.addEventListener("click", () => this.#made());
    close.addEventListener("click", () => this.dialog.close());
    this.#chosen();
    return true;
  }

  open() {
    this.#line();
    this.dialog.showModal();
  }

  #offer() {
    return this.offers.find(({ product }) => product === this.kind.value);
  }

  #chosen() {
    const { endings, options } = this.#offer();
    this.ending.replaceChildren(
      ...endings.map((ending) => new Option(ending.slice(1).toUpperCase(), ending)),
    );
    this.inputs.clear();
    this.fields.replaceChildren(...options.map((name) => this.#field(name)));
    this.#line();
  }

  #field(name) {
    const option = OPTIONS[name];
    const id = `product-${name}`;
    let input;
    if (option.choices)
      input = made(
        "select",
        { id },
        ...option.choices.map(([value, text]) => new Option(text, value)),
      );
    else if (option.check) input = made("input", { id, type: "checkbox" });
    else
      input = made("input", {
        id,
        type: "number",
        min: option.least,
        max: option.most,
        step: "any",
        value: option.value,
        placeholder: option.empty ?? "",
      });
    if (name in this.kept) input[option.check ? "checked" : "value"] = this.kept[name];
    input.addEventListener("input", () => {
      this.kept[name] = option.check ? input.checked : input.value;
    });
    this.inputs.set(name, input);
    return made("label", { htmlFor: id }, made("span", { textContent: option.label }), input);
  }

  /** Show what is missing for a section. */
  #line() {
    const wanting = this.kind.value === "section" && !this.page.section();
    this.#say(wanting ? "Close this, draw a line on the map (L), and come back." : "", wanting);
    this.make.disabled = wanting;
  }

  #say(text, wrong = false) {
    this.said.textContent = text;
    this.said.classList.toggle("wrong", wrong);
  }

  #request() {
    const request = {
      product: this.kind.value,
      ending: this.ending.value,
      channel: this.page.channel(),
    };
    for (const [name, input] of this.inputs) {
      const option = OPTIONS[name];
      if (!input.checkValidity()) throw new Error(`${option.label}: ${input.validationMessage}`);
      if (option.check) request[name] = input.checked;
      else if (option.choices) request[name] = input.value;
      else if (input.value !== "") request[name] = Number(input.value) * (option.metres ? 1e-3 : 1);
    }
    if (request.product === "section") request.pixels = this.page.section();
    return request;
  }

  async #made() {
    this.make.disabled = true;
    this.#say("Being made…");
    try {
      const { name, said, blob } = await this.page.source.product(this.#request());
      download(name, blob);
      this.#say(`${name}: ${said}`);
    } catch (error) {
      this.#say(error.message, true);
    }
    this.make.disabled = false;
  }
}
