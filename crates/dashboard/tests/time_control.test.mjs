import assert from "node:assert/strict";
import { test } from "node:test";

import { speeds } from "../page/time_control.js";

test("the present speed is among those to choose from, in its place", () => {
    assert.deepEqual(speeds("max").at(-1), "max");
    const own = speeds(3);
    assert.deepEqual(own.slice(own.indexOf(2), own.indexOf(5) + 1), [2, 3, 5]);
    assert.equal(own.at(-1), "max");
});
