import assert from "node:assert/strict";
import { test } from "node:test";

import { decode } from "../page/scan.js";

/** Writes a LaserScan as ROS 2 does. */
function scan(frame, ranges) {
    const name = new TextEncoder().encode(`${frame}\0`);
    const head = 8 + 4 + name.length;
    const start = head + ((4 - (head % 4)) % 4);
    const bytes = new Uint8Array(4 + start + 7 * 4 + 4 + 4 * ranges.length + 4);
    bytes.set([0, 1, 0, 0]);
    const view = new DataView(bytes.buffer, 4);
    view.setUint32(8, name.length, true);
    bytes.set(name, 4 + 12);
    // angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max
    [0, Math.PI, Math.PI / 2, 0, 0.1, 0.15, 8].forEach((value, i) => view.setFloat32(start + 4 * i, value, true));
    view.setUint32(start + 28, ranges.length, true);
    ranges.forEach((value, i) => view.setFloat32(start + 32 + 4 * i, value, true));
    return bytes;
}

const rounded = (points) => points.map(({ x, y }) => [x, y].map((value) => Math.round(value * 1000) / 1000 + 0));

test("rays become points, whatever the length of the frame's name", () => {
    for (const frame of ["a", "ab", "abc", "base_laser"]) {
        assert.deepEqual(rounded(decode(scan(frame, [1, 2, 3]))), [[1, 0], [0, 2], [-3, 0]]);
    }
});

test("rays without an echo are left out", () => {
    assert.deepEqual(rounded(decode(scan("a", [Infinity, 2, 0.01, NaN, 9]))), [[0, 2]]);
});

test("bytes that are no scan are rejected", () => {
    assert.throws(() => decode(new Uint8Array([0, 0, 0, 0])), /little-endian/);
    assert.throws(() => decode(scan("a", [1, 2, 3]).slice(0, 60)), RangeError);
});
