// Events become the model, whatever their order and number.

import assert from "node:assert/strict";
import { test } from "node:test";

import { subjects } from "../page/charts.js";
import { describe, Model, PARTS } from "../page/state.js";
import { carrying, columns, figures, links, places, vnfsByNode } from "../page/topology.js";

const testbed = () => ({
    name: "lab",
    description: "",
    graph: {
        domains: [], links: [], wireless: {},
        nodes: [
            { id: "robot", kind: "robot", position: { x: 0, y: 0 } },
            { id: "R1", kind: "radio_unit", position: { x: 1, y: 0 } },
            { id: "R2", kind: "radio_unit", position: { x: 9, y: 0 } },
        ],
    },
    services: [{ id: "navigation", robot: "robot", vnfs: [], virtual_links: [], kpis: { service_time_target_ms: 15 } }],
    walks: [], plugins: [], version: "0",
});

const robot = (second, x, unit) => ({
    at_ns: second * 1e9, event: "robot", robot: "robot", waypoint: 0,
    attachments: [{ radio_unit: unit, attached: true, signal_dbm: -50 - x }],
    sensors: { pose: { x, y: 0, heading: 0, covariance: [1, 0, 0, 0, 1, 0, 0, 0, 1] }, velocity: { linear: 1, angular: 0 } },
});
const handover = (second, from, to) => ({ at_ns: second * 1e9, event: "handover", robot: "robot", from, to, fast: true, gap_ms: 30 });
const sample = (second, ms) => ({ at_ns: second * 1e9, event: "service_time", service: "navigation", service_time_ms: ms });

test("a handover ends a region and begins the next at its own time", () => {
    const model = new Model(testbed());
    model.take(robot(1, 0, "R1"));
    model.take(handover(2.5, "R1", "R2"));
    model.take(robot(3, 1, "R2"));
    assert.deepEqual(model.robots.get("robot").regions, [
        { from: 1, until: 2.5, unit: "R1" },
        { from: 2.5, until: null, unit: "R2" },
    ]);
    assert.equal(model.robots.get("robot").unit, "R2");
});

test("a handover attaches a robot before its next report, and no older one does", () => {
    const model = new Model(testbed());
    const unit = () => model.robots.get("robot").unit;
    model.take(robot(1, 0, "R1"));
    model.take(handover(1.5, "R1", "R2"));
    assert.equal(unit(), "R2");
    model.take({ at_ns: 1.6e9, event: "detached", robot: "robot" });
    assert.equal(unit(), null);
    model.take(robot(2, 1, "R2"));
    model.take(handover(1.9, "R2", "R1"));
    assert.equal(unit(), "R2");
});

test("regions of the history begin with the run, and the stream continues them", () => {
    const model = new Model(testbed());
    model.recount(handover(10, "R1", "R2"));
    model.begin({ at_ns: 20e9, robots: [robot(20, 5, "R2")], links: [], placements: [], virtual_links: [], radio_units: [] });
    model.take({ at_ns: 30e9, event: "detached", robot: "robot" });
    assert.deepEqual(model.robots.get("robot").regions, [
        { from: 0, until: 10, unit: "R1" },
        { from: 10, until: 30, unit: "R2" },
    ]);
});

test("a robot without handovers was attached since the run began", () => {
    const model = new Model(testbed());
    model.begin({ at_ns: 20e9, robots: [robot(20, 5, "R2")], links: [], placements: [], virtual_links: [], radio_units: [] });
    assert.deepEqual(model.robots.get("robot").regions, [{ from: 0, until: null, unit: "R2" }]);
});

test("what history and stream both have is there once", () => {
    const model = new Model(testbed());
    model.recount(handover(10, "R1", "R2"));
    model.take(handover(10, "R1", "R2"));
    model.take(handover(9, "R2", "R1"));
    assert.deepEqual(model.entries.map((entry) => entry.title), ["robot: R1 → R2"]);
    model.take(sample(10, 11));
    model.take(sample(10, 12));
    assert.equal(model.figure("service_time:navigation").last, 11);
});

test("a long run stays in bounded memory", () => {
    const model = new Model(testbed());
    for (let i = 0; i < 30_000; i++) {
        model.take(robot(i, i, i % 2 ? "R1" : "R2"));
        model.take(handover(i, i % 2 ? "R2" : "R1", i % 2 ? "R1" : "R2"));
        model.take(sample(i, i));
    }
    const { entries, robots } = model;
    const { regions, trail } = robots.get("robot");
    assert.ok(entries.length <= 4000 && regions.length <= 2000 && trail.length <= 1500);
    assert.equal(entries.at(-1).at, 29_999);
});

test("a refused decision names the plug-in, the instruction and the reason", () => {
    const words = describe({
        at_ns: 0, event: "decision", plugin: "okpi", reason: "closer", refused: "no room",
        instruction: { instruction: "place", vnf: "navigation", node: ["edge", "fog"] },
    });
    assert.deepEqual(words, {
        group: "decision", title: "okpi: place navigation on edge, fog", detail: "closer; refused: no room", bad: true,
    });
    assert.equal(describe({ at_ns: 0, event: "goal", state: "progress", robot: "robot", goal: { x: 0, y: 0 } }), null);
});

test("the topology follows placements, attachments and virtual links", () => {
    const lab = testbed();
    lab.graph.nodes.push({ id: "cloud", kind: "server", tier: "cloud" }, { id: "fog", kind: "server", tier: "fog" });
    lab.graph.links.push({ id: "R1-fog", ends: ["R1", "fog"] });
    const model = new Model(lab);
    assert.deepEqual(columns(model), [["robot"], ["R1", "R2"], ["fog", "cloud"]]);
    model.take(robot(1, 0, "R1"));
    model.take({ at_ns: 1e9, event: "placement", vnf: "navigation", node: ["fog", "cloud"] });
    model.take({ at_ns: 1e9, event: "virtual_link", from: "driver", to: "navigation", links: ["robot~R1", "R1-fog"], path: "shortest" });
    assert.deepEqual([...vnfsByNode(model)], [["fog", ["navigation"]], ["cloud", ["navigation"]]]);
    assert.deepEqual(links(model).map(({ id }) => id), ["R1-fog", "robot~R1"]);
    assert.deepEqual([...carrying(model)], ["robot~R1", "R1-fog"]);
    const link = { at_ns: 1e9, event: "link", link: "R1-fog", direction: "forward", delay_ms: 4.5, throughput_bps: 80_000 };
    model.take({ ...link, probed: { loss: 0.02, loss_age_ms: 1 } });
    assert.deepEqual(figures(model, "R1-fog"), { delay: "4.50 / – ms", rate: "80.0 kbit/s", loss: "2.0 % lost", queue: "" });
});

test("no link passes behind a node, where the column has room", () => {
    const all = [["R1", "R2", "R3"], ["lan"], ["fog", "cloud"]];
    const straight = all[0].flatMap((unit) => all[2].map((server) => ({ id: `${unit}-${server}`, ends: [unit, server] })));
    const size = { width: 600, height: 400 };
    const of = (links) => places(all, new Map(), links, size);
    assert.equal(of([{ id: "lan-fog", ends: ["lan", "fog"] }]).get("lan").y, 200, "without such links it stands in the middle");
    const found = of(straight);
    const { y } = found.get("lan");
    assert.ok(y > 11 && y < 389, "its box is whole");
    for (const { ends } of straight) assert.ok(Math.abs(ends.reduce((sum, end) => sum + found.get(end).y, 0) / 2 - y) > 11, ends.join());
    assert.deepEqual(all[0].map((unit) => Math.round(found.get(unit).y)), [67, 200, 333], "the other columns stay");
});

test("the longer queue of a link is shown while packets wait", () => {
    const model = new Model(testbed());
    const link = (direction, queued) => model.take({ at_ns: 1e9, event: "link", link: "R1-fog", direction, throughput_bps: 0, ...queued });
    const queue = () => figures(model, "R1-fog").queue;
    assert.equal(queue(), "");
    link("forward", {});
    link("backward", { queued_packets: null });
    assert.equal(queue(), "");
    link("forward", { queued_packets: 0 });
    assert.equal(queue(), "");
    link("backward", { queued_packets: 12 });
    assert.equal(queue(), "12 queued");
});

test("the localization error of the chosen robot has a chart", () => {
    const lab = testbed();
    lab.graph.nodes.push({ id: "other", kind: "robot", position: { x: 0, y: 1 } });
    const model = new Model(lab);
    const { figures: of, unit, isOptional } = subjects(model).find(({ title }) => title === "Localization error");
    assert.deepEqual([unit, isOptional], ["m", true]);
    const shown = (focus) => of(focus).map(({ figure }) => model.figure(figure).last);
    model.take(robot(1, 0, "R1"));
    model.take({ ...robot(2, 0, "R1"), localization_error_m: null });
    assert.deepEqual(shown("robot"), [NaN], "an unknown error is no value");
    model.take({ ...robot(3, 0, "R1"), localization_error_m: 0.25 });
    model.take({ ...robot(3, 0, "R1"), robot: "other", localization_error_m: 0.5 });
    assert.deepEqual([shown("robot"), shown("other"), shown(null)], [[0.25], [0.5], [0.25]]);
    assert.ok(subjects(new Model({ ...lab, graph: { ...lab.graph, nodes: [] } })).every(({ title }) => title !== "Localization error"));
});

test("the parts of a service time add up to it", () => {
    const model = new Model(testbed());
    const link = (name, back) => ({ link: name, direction: "forward", back, queueing_ms: 0.5, retries_ms: 0.25, crossing_ms: 2 });
    const links = [link("robot~R1", false), link("R1-edge", false), link("R1-edge", true), link("robot~R1", true)];
    const parts = { sender_ms: 0.125, vnf_ms: 1, receiver_ms: 0.0625, unknown_time_ms: 0.03125, links };
    model.take({ ...sample(1, 12.21875), parts });
    const values = PARTS.map((part) => model.figure(`split:navigation:${part}`).last);
    assert.deepEqual(values, [4.5, 4.5, 2, 1, 0.21875]);
    assert.equal(values.reduce((sum, value) => sum + value), 12.21875);
});
