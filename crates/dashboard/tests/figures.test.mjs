// Figures over time, their axes, and what is drawn of them.

import assert from "node:assert/strict";
import { test } from "node:test";

import { EventParser } from "../page/api.js";
import { csv } from "../page/charts.js";
import { clock, figure, ticks, timeTicks } from "../page/format.js";
import { judged, kept, wilson } from "../page/kept.js";
import { ellipse } from "../page/map.js";
import { palette } from "../page/palette.js";
import { read } from "../page/pgm.js";
import { draw, range, reduce, Svg } from "../page/plot.js";
import { spans } from "../page/raster.js";
import { Series } from "../page/series.js";
import { TimeAxis } from "../page/time_axis.js";
import { filtered } from "../page/timeline.js";

const scanned = (series, from, until) => {
    const all = [];
    series.scan(from, until, (at, low, high, last) => all.push({ at, low, high, last }));
    return all;
};

test("old samples become steps that keep their extremes", () => {
    const series = new Series();
    const count = 100_000;
    for (let i = 0; i < count; i++) series.add(i / 20, i === 777 ? 500 : i % 10);
    const all = scanned(series, 0, count);
    assert.ok(all.length <= 8192 + 2048);
    assert.equal(Math.max(...all.map(({ high }) => high)), 500);
    assert.equal(Math.min(...all.map(({ low }) => low)), 0);
    assert.ok(all.every(({ at }, i) => i === 0 || at > all[i - 1].at));
    assert.equal(series.last, (count - 1) % 10);
});

test("the history comes before the stream, and no sample counts twice", () => {
    const series = new Series();
    series.addStep(10, 1, 3, 2);
    series.add(9, 100);
    series.add(11, 4);
    assert.deepEqual(scanned(series, 0, 20).map(({ last }) => last), [2, 4]);
    assert.equal(series.valueAt(10.5).value, 2);
    assert.equal(series.valueAt(12).value, 4);
    assert.equal(series.countWithin(15, 0, 20), null, "extremes do not tell a share");
    assert.deepEqual(series.countWithin(3, 10, 20), { within: 0, samples: 1 });
});

test("a share within a target counts samples without an answer as outside", () => {
    const series = new Series();
    [10, 20, NaN, 15].forEach((value, i) => series.add(i + 1, value));
    assert.deepEqual(series.countWithin(15, 0, 10), { within: 2, samples: 4 });
    assert.equal(series.countWithin(15, 20, 30), null);
});

test("a demanded share passes or fails, and few samples are said not to be enough", () => {
    const of = (within, samples, keep) => kept({ within, samples }, keep);
    assert.equal(of(949, 1000, null), "94.9 % of 1000 in time");
    assert.equal(of(949, 1000, 0.99), "94.9 % of 1000 in time: FAIL (99 % demanded)");
    assert.equal(of(1000, 1000, 0.99), "100.0 % of 1000 in time: PASS (99 % demanded)");
    assert.equal(of(20, 20, 0.99), "100.0 % of 20 in time: PASS (99 % demanded, too few to be sure)");
    assert.equal(of(98996, 100000, 0.99).slice(0, 8), "98.996 %", "it does not look like 99 %");
    assert.equal(of(9999, 10000).slice(0, 6), "99.9 %", "it does not look like all");
    assert.deepEqual(wilson(81, 263).map((bound) => bound.toFixed(4)), ["0.2553", "0.3662"]);
});

test("KPIs have the verdicts of a recorded run, and none before its end", () => {
    const services = [{ id: "navigation", kpis: { require: ["cost <= 3"] } }, { id: "other", kpis: {} }];
    assert.deepEqual(judged(services, []), { verdict: null, sentences: ["navigation: cost <= 3."] });
    const kpis = [
        { kpi: "cost <= 3", value: 2, verdict: "PASS", measured: "2" },
        { kpi: "service_time p95 <= 15 ms", value: null, verdict: "FAIL", reason: "4 of 9 samples have no answer" },
        { kpi: "area", value: null, verdict: null, reason: "a run shows no area" },
    ];
    const { verdict, sentences } = judged(services, [{ service: "navigation", kpis }]);
    assert.equal(verdict, "FAIL");
    assert.deepEqual(sentences, [
        "navigation: cost <= 3: PASS, 2.",
        "navigation: service_time p95 <= 15 ms: FAIL, 4 of 9 samples have no answer.",
        "navigation: area: not judged, a run shows no area.",
    ]);
});

const plot = (values, options = {}) => {
    const series = new Series();
    values.forEach((value, i) => series.add(i, value));
    return {
        from: 0, until: values.length - 1, lines: [{ name: "a, b", series, index: 0 }], bands: [], marks: [], target: null,
        unit: "ms", fromZero: true, longestGap: null, ...options,
    };
};

/** Values of the points of a plot's only line. */
const reduced = (one, width) => {
    const [{ values, length }] = reduce(one, width);
    return [...values.subarray(0, length)];
};

test("a line has few points in a column, however many samples, and loses no peak", () => {
    const values = Array.from({ length: 8000 }, (_, i) => (i === 4321 ? 99 : i % 7));
    const one = plot(values);
    const points = reduced(one, 100);
    assert.ok(points.length <= 4 * 102, points.length);
    assert.ok(points.includes(99));
    const torn = reduced(plot(values.map((value, i) => (i % 2 === 0 ? NaN : value))), 100);
    assert.ok(torn.length <= 4 * 102 && torn.includes(99), torn.length);
});

test("missing samples break a line", () => {
    assert.deepEqual(reduced(plot([1, NaN, 2]), 100), [1, NaN, 2]);
    assert.deepEqual(reduced(plot([1, 2, 3], { longestGap: 0.5 }), 100), [1, NaN, 2, NaN, 3]);
});

test("a few spikes do not flatten the rest, and the target is in sight", () => {
    const values = Array.from({ length: 1000 }, (_, i) => (i % 300 === 0 ? 155 : 11));
    const ranged = (one, width) => range(one, reduce(one, width));
    const { low, high } = ranged(plot(values, { target: 15 }), 1000);
    assert.equal(low, 0);
    assert.ok(high > 15 && high < 40, high);
    const steady = ranged(plot([20, 20, 20], { target: 15 }), 100);
    assert.ok(steady.high > 20);
});

test("a plot is drawn as SVG with its lines, its target and its regions, and names are escaped", () => {
    const svg = new Svg();
    const band = { from: 0, until: 2, index: 0, name: "<R1>" };
    draw(svg, 400, 200, plot([1, 2, 3], { target: 2, bands: [band], marks: [{ at: 1, bad: true }] }), palette(false));
    const text = svg.text(400, 200, "#ffffff");
    assert.match(text, /&lt;R1&gt;/);
    assert.match(text, /target 2\.00 ms/);
    assert.ok(!/NaN|undefined/.test(text), text);
});

test("a table has the samples of the window, and quotes names", () => {
    const rows = csv({ ...plot([1, 2, 3]), from: 1 }).trim().split("\n");
    assert.deepEqual(rows, ["at_s,series,min,max,last", '1.000000,"a, b",2,2,2', '2.000000,"a, b",3,3,3']);
});

test("times and figures are written for people", () => {
    assert.deepEqual([clock(65), clock(3725), clock(59.96, 1), clock(NaN)], ["1:05", "1:02:05", "1:00.0", "–:––"]);
    assert.deepEqual([figure(11.212, "ms"), figure(-50.13, "dBm"), figure(null)], ["11.2 ms", "−50.1 dBm", "–"]);
    assert.deepEqual([figure(6.2e6, "bit/s"), figure(999_700, "bit/s"), figure(12, "bit/s")], ["6.20 Mbit/s", "1.00 Mbit/s", "12 bit/s"]);
});

test("axes have round places", () => {
    assert.deepEqual(ticks(0, 40, 4).places, [0, 10, 20, 30, 40]);
    assert.deepEqual(timeTicks(50, 130, 4).places, [60, 90, 120]);
    assert.equal(ticks(5, 5, 4).places.length, 1);
});

test("the axis follows the present until it is moved, and comes back", () => {
    const axis = new TimeAxis();
    assert.deepEqual(axis.window(100), { from: 40, until: 100 });
    axis.pan(-0.5, 100);
    assert.deepEqual(axis.window(200), { from: 10, until: 70 });
    axis.zoom(0.5, 0.5, 200);
    assert.deepEqual(axis.window(200), { from: 25, until: 55 });
    axis.pan(100, 200);
    assert.ok(axis.window(200).from < 200, "some of the run stays in sight");
    axis.follow(null);
    assert.deepEqual(axis.window(500), { from: 0, until: 500 });
});

test("events of the stream are whole, however they are cut", () => {
    const text = 'data: {"a":1}\n\n: alive\n\nevent: missed\ndata: 7\n\ndata: {"b"';
    for (const size of [1, 3, 1000]) {
        const parser = new EventParser();
        const all = [];
        for (let i = 0; i < text.length; i += size) all.push(...parser.push(text.slice(i, i + size)));
        assert.deepEqual(all, [{ name: "message", data: '{"a":1}' }, { name: "missed", data: "7" }]);
    }
    assert.throws(() => new EventParser().push("x".repeat(5 << 20)));
});

test("an ellipse holds the robot in 95 of 100 cases", () => {
    const { major, minor, angle } = ellipse([4, 0, 0, 0, 1, 0, 0, 0, 1]);
    assert.ok(Math.abs(major - 2 * Math.sqrt(5.991)) < 1e-9 && Math.abs(minor - Math.sqrt(5.991)) < 1e-9 && angle === 0);
    assert.ok(Math.abs(ellipse([1, 1, 0, 1, 1, 0, 0, 0, 1]).angle - Math.PI / 4) < 1e-9);
});

test("a map's picture is read, and what is none is rejected", () => {
    const file = new Uint8Array([...new TextEncoder().encode("P5\n2 1\n255\n"), 0, 254]);
    assert.deepEqual(read(file), { width: 2, height: 1, pixels: file.subarray(-2) });
    assert.throws(() => read(file.subarray(0, -1)));
});

test("the filter of the timeline looks at groups and words", () => {
    const entries = [
        { group: "handover", title: "robot: R1 → R2", detail: "" },
        { group: "decision", title: "okpi: attach", detail: "R2 is closer" },
    ];
    assert.equal(filtered(entries, new Set(), "r2").length, 2);
    assert.deepEqual(filtered(entries, new Set(["handover"]), "r2"), [entries[1]]);
});

test("a line as pixels covers every column between its points, and none in a gap", () => {
    const [tops, bottoms] = [new Float32Array(8), new Float32Array(8)];
    const points = [[0.5, 4], [3.5, 1], [4, NaN], [6.5, 2], [6.5, 7]];
    const [xs, values] = [0, 1].map((i) => Float64Array.from(points, (point) => point[i]));
    spans({ xs, values, length: points.length }, tops, bottoms);
    const covered = [...tops].map((top, i) => (top <= bottoms[i] ? [top, bottoms[i]] : null));
    assert.deepEqual(covered, [[3.5, 4], [2.5, 3.5], [1.5, 2.5], [1, 1.5], null, null, [2, 7], null]);
});
