import assert from "node:assert/strict";
import { test } from "node:test";

import { coarse, Details } from "../page/detail.js";
import { Series } from "../page/series.js";
import { Model } from "../page/state.js";

const testbed = { name: "lab", description: "", graph: { domains: [], links: [], wireless: {}, nodes: [] }, services: [], walks: [], plugins: [] };
const point = (second, value) => ({ from_ns: 0, until_ns: second * 1e9, count: 1, min: value, max: value, mean: value, last: value });
const curve = (figure, points) => ({ figure, points });

/** A run of 100 s, of which the history had a step each ten seconds. */
function model() {
    const model = new Model(testbed);
    model.recall(curve("a", [10, 20, 30, 40, 50, 60, 70, 80, 90, 100].map((second) => point(second, 1))));
    model.now = 100;
    return model;
}

test("figures in steps are coarse where the steps are, and those of the page alone are not", () => {
    const it = model();
    it.figure("b").add(50, 1);
    assert.deepEqual(coarse(it, ["a", "b", "split:a:air", "other:a"], { from: 20, until: 30 }), ["a"]);
    assert.deepEqual(coarse(it, ["a"], { from: 100, until: 130 }), []);
});

test("a stretch is read once, with a margin, and shown only where it is known", async (t) => {
    t.mock.timers.enable({ apis: ["setTimeout"] });
    const it = model();
    const asked = [];
    let changes = 0;
    const read = async (figure, stretch) => {
        asked.push([figure, stretch]);
        return curve(figure, [point(24, 2), point(25, 3)]);
    };
    const details = new Details(it, read, () => (changes += 1));
    const rest = async () => {
        t.mock.timers.tick(1000);
        for (let turn = 0; turn < 20; turn++) await Promise.resolve();
    };
    details.want(["a"], { from: 50, until: 60 });
    details.want(["a"], { from: 20, until: 30 });
    await rest();
    assert.deepEqual(asked, [["a", { from: 15, until: 35 }]]);
    assert.equal(it.closest("a", 20, 30).valueAt(25).value, 3);
    assert.equal(it.closest("a", 10, 30), it.figure("a"));
    details.want(["a"], { from: 22, until: 32 });
    await rest();
    assert.deepEqual([asked.length, changes], [1, 1]);
    details.want(["a"], { from: 95, until: 100 });
    await rest();
    assert.deepEqual(asked[1], ["a", { from: 92.5, until: 100 }]);
});

test("gaps of the history stay gaps", () => {
    const read = new Series();
    read.addCurve(curve("a", [point(1, 5), { from_ns: 1e9, until_ns: 2e9, lost: true }]));
    assert.ok(Number.isNaN(read.last));
});
