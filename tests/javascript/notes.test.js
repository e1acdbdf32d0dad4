// Notes in the browser replace those of the page only if they are newer and whole.

import assert from "node:assert/strict";
import { test } from "node:test";

import { newest } from "../../src/amulor/view/page/static/notes.js";

const own = { revision: 3, annotations: [], views: [{ name: "front" }], file: null };

test("newer notes of the browser are taken, older ones and damaged ones are not", () => {
  const kept = { revision: 4, annotations: [{ name: "crack" }], views: [], file: "other" };
  const found = newest(own, JSON.stringify(kept));
  assert.deepEqual(found.annotations, kept.annotations);
  // Where notes are kept is not part of them.
  assert.equal(found.file, null);
  for (const stored of [null, "{", "4", JSON.stringify({ ...kept, revision: 3 }), '{"revision":9}'])
    assert.equal(newest(own, stored), own);
});
