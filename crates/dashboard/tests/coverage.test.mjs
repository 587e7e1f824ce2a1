// Radio coverage: which rings a view shows, and where their labels stand.

import assert from "node:assert/strict";
import { test } from "node:test";

import { rings } from "../page/coverage.js";

const circles = [[-50, 4], [-60, 10], [-70, 30]].map(([signal_dbm, radius_m]) => ({ signal_dbm, radius_m }));
const VIEW = { width: 400, height: 400 };
const shown = (places, scale, view = VIEW) =>
    rings(Object.keys(places).map((radio_unit) => ({ radio_unit, circles })), (unit) => places[unit], scale, view);

test("rings are as wide as their radius, and the widest are drawn first", () => {
    const all = shown({ R1: { x: 200, y: 200 } }, 6);
    assert.deepEqual(all.map(({ signal, radius }) => [signal, radius]), [[-70, 180], [-60, 60], [-50, 24]]);
    assert.deepEqual(all.map(({ label }) => label?.x), [380, 260, undefined], "no label fits beside the radio unit itself");
});

test("rings that the view does not reach are left out", () => {
    assert.deepEqual(shown({ R1: { x: -100, y: 200 } }, 6).map(({ signal }) => signal), [-70]);
    assert.deepEqual(shown({ R1: { x: -300, y: 200 } }, 6), []);
    assert.deepEqual(shown({ R1: { x: 200, y: 200 } }, 60).map(({ signal }) => signal), [-50], "the view lies within the others");
    assert.deepEqual(shown({ R1: null }, 6), [], "a radio unit without a place");
});

test("labels stand where no other radio unit is stronger", () => {
    const all = shown({ R1: { x: 150, y: 200 }, R2: { x: 250, y: 200 } }, 6);
    const label = (unit, signal) => all.find((ring) => ring.unit === unit && ring.signal === signal).label;
    assert.deepEqual([label("R1", -60).y, label("R2", -60).x], [140, 310], "not to the right of R1, where R2 is");
});

test("labels stand in the view, and never on each other", () => {
    const places = Object.fromEntries(Array.from({ length: 12 }, (_, i) => [`R${i}`, { x: 30 * i, y: 35 * i }]));
    const labels = shown(places, 6).flatMap(({ label }) => label ?? []);
    assert.ok(labels.length > 6);
    for (const [i, one] of labels.entries()) {
        assert.ok(one.x > 0 && one.x < VIEW.width && one.y > 0 && one.y < VIEW.height);
        for (const other of labels.slice(0, i)) assert.ok(Math.abs(one.x - other.x) > 30 || Math.abs(one.y - other.y) > 14);
    }
});
