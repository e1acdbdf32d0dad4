// The button that copies the commands of a block of code.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import vm from "node:vm";

const SCRIPT = new URL("../../docs/_static/copy.js", import.meta.url);

// Text that the button of a block with this content writes to the clipboard.
async function copied(textContent) {
  let written = null;
  let ready = null;
  const listeners = [];
  const button = {
    addEventListener: (event, listener) => listeners.push([event, listener]),
  };
  const block = { textContent, parentElement: { style: {}, append() {} } };
  vm.runInNewContext(readFileSync(SCRIPT, "utf8"), {
    document: {
      addEventListener: (event, listener) => {
        if (event === "DOMContentLoaded") ready = listener;
      },
      querySelectorAll: () => [block],
      createElement: () => button,
    },
    navigator: {
      clipboard: {
        writeText: async (text) => {
          written = text;
        },
      },
    },
    setTimeout: () => 0,
  });
  ready();
  assert.deepEqual(
    listeners.map(([event]) => event),
    ["click"],
  );
  await listeners[0][1]();
  assert.equal(button.textContent, "Copied");
  return written;
}

test("a command is copied without its prompt and its output", async () => {
  assert.equal(await copied("$ amulor demo\nwritten to demo\n"), "amulor demo");
});

test("all lines of a continued command are copied", async () => {
  const block = "$ amulor image target.nc \\\n    -o image.nc\nimage.nc: 1 %\n$ amulor --help\n";
  assert.equal(await copied(block), "amulor image target.nc \\\n    -o image.nc\namulor --help");
});

test("output that ends in a backslash does not continue a command", async () => {
  assert.equal(await copied("$ ls\nC:\\\nD:\\\n"), "ls");
});

test("commands after the prompt of Windows are copied", async () => {
  assert.equal(await copied("> amulor demo\n"), "amulor demo");
});

test("a block without a prompt is copied as it is", async () => {
  const block = "from amulor import simulate\n\ncube = simulate(survey)\n";
  assert.equal(await copied(block), block);
});
