// Color scales with one meaning each, distinguishable by color-blind readers.

/**
 * @typedef {object} Layer
 * @property {string} name
 * @property {string} label
 * @property {string} unit
 * @property {"range" | "amplitude" | "error" | "chance" | "signed" | "flags" | "hidden"} kind
 * @property {boolean} before with the water signal
 * @property {boolean} [derived] computed here
 */
/** @typedef {{name: string, mask: number, words: string, unusable: boolean}} Flag */

const STOPS = {
  // viridis and cividis (matplotlib, CC0), gray, and ColorBrewer's RdBu with gray in place
  // of white, which a light page would hide.
  viridis:
    "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d2f6b8e2c728e297a8e26828e23898e21918c1f988b1fa08822a78528ae8032b67a3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725",
  cividis:
    "00224e00285b002e6a0533711a386f273e6e32436d3b496c434e6c4b546c535a6d5a5f6e61656f686a716f70737676767d7c788482798c8878938e789b9476a39a74aba072b4a76fbcae6cc4b468cdbb63d5c25edec958e7d150f0d846f9e03afee838",
  grey: "0a0a0a1111111919192121212828283030303838384040404747474f4f4f5757575e5e5e6666666e6e6e7575757d7d7d8585858c8c8c9494949c9c9ca3a3a3abababb3b3b3bababac2c2c2cacacad1d1d1d9d9d9e1e1e1e8e8e8f0f0f0f8f8f8ffffff",
  signed:
    "10457e1854931f63a82a71b2337eb83e8cbf4c99c662a7ce7bb6d694c3d9a6c8dab5ccd8beccd5c0cad0bfc6cabbc0c4b4b9bdbdc0c2c6c4c5cfc7c3d8c6bcdfc0b0e6b49eeba788eb9172e27b62da6853d05548c53e3dbb2a34ae172a991027840924",
};

/** @typedef {keyof typeof STOPS} MapName */

/** Names of all color scales. */
export const MAPS = /** @type {MapName[]} */ (Object.keys(STOPS));

/**
 * Color scale of each kind of map.
 * @type {Record<string, MapName>}
 */
export const MAP_OF = {
  range: "viridis",
  amplitude: "grey",
  error: "cividis",
  chance: "cividis",
  signed: "signed",
};

// Colors of Okabe and Ito, for lines and flags.
export const INK = {
  blue: "#0072B2",
  vermilion: "#D55E00",
  green: "#009E73",
  purple: "#CC79A7",
  orange: "#E69F00",
  sky: "#56B4E9",
  yellow: "#F0E442",
  grey: "#7a8790",
};

/** @type {Record<string, string>} */
const FLAG_COLOURS = {
  missing: "#8a949b",
  saturated: INK.vermilion,
  "no target": "#4a555c",
  ambiguous: INK.purple,
  "water residual": INK.sky,
  "no open water": INK.blue,
  mixed: INK.orange,
  outlier: INK.yellow,
  relative: INK.green,
  corner: INK.grey,
};

/**
 * @param {string} name
 */
export function flagColour(name) {
  return FLAG_COLOURS[name] ?? INK.grey;
}

/**
 * Return the name of a flag for `amulor explain`.
 * @param {string} name
 */
export function explained(name) {
  return name.toUpperCase().replaceAll(" ", "_");
}

/**
 * @param {string} hex
 */
function channels(hex) {
  return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

/** @param {MapName} name */
function hexes(name) {
  return STOPS[name].match(/.{6}/g) ?? [];
}

/**
 * Return the 256 colors of a scale as RGBA bytes.
 * @param {MapName} name
 */
export function table(name) {
  const stops = hexes(name).map(channels);
  const out = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; i += 1) {
    const place = (i / 255) * (stops.length - 1);
    const low = Math.min(Math.floor(place), stops.length - 2);
    for (let k = 0; k < 3; k += 1) {
      const mixed = stops[low][k] + (place - low) * (stops[low + 1][k] - stops[low][k]);
      out[4 * i + k] = Math.round(mixed);
    }
    out[4 * i + 3] = 255;
  }
  return out;
}

/**
 * Return the colors of flags, one texel each; texel 0 is for good pixels.
 * @param {Flag[]} flags
 * @param {string} good
 */
export function flagTable(flags, good) {
  const out = new Uint8Array(256 * 4).fill(255);
  out.set(channels(good.slice(1)), 0);
  flags.forEach((flag, at) => out.set(channels(flagColour(flag.name).slice(1)), 4 * (at + 1)));
  return out;
}

/**
 * Return the texel of `flagTable` for each pixel: that of its first flag that makes it
 * unusable, or else of its first flag.
 * @param {ArrayLike<number>} values
 * @param {Flag[]} flags
 */
export function flagRanks(values, flags) {
  const order = [...flags.keys()].sort(
    (a, b) => Number(flags[b].unusable) - Number(flags[a].unusable),
  );
  const known = new Map();
  return Float32Array.from(values, (bits) => {
    if (!known.has(bits)) {
      const found = order.find((k) => bits & flags[k].mask);
      known.set(bits, found === undefined ? 0 : found + 1);
    }
    return known.get(bits);
  });
}
