import assert from "node:assert/strict";
import { test } from "node:test";

import { declared, locate, suggest } from "../page/complete.js";

const duration = { type: "string", examples: ["5 ms"], description: "Time. More words." };
const node = {
    oneOf: [
        {
            type: "object", additionalProperties: false, required: ["kind"],
            properties: { kind: { const: "robot" }, cpus: { type: "number", examples: [2] }, roaming: { enum: ["free", "instructed"] } },
        },
        { type: "object", additionalProperties: false, required: ["kind"], properties: { kind: { const: "switch" } } },
    ],
};
const schema = {
    type: "object",
    properties: {
        name: { type: "string" },
        nodes: { type: "object", additionalProperties: node },
        links: {
            type: "array",
            items: {
                type: "object",
                properties: { ends: { type: "array", items: { type: "string" } }, delay: duration, up: { type: "boolean" } },
            },
        },
    },
};

/** Labels at the cursor `|`. */
function labels(text) {
    const place = locate(text.split("|")[0]);
    return place && suggest(schema, place).map(({ label }) => label);
}

test("keys of the file, without those that are there", () => {
    assert.deepEqual(labels("|"), ["name", "nodes", "links"]);
    assert.deepEqual(labels("name: x\nn|"), ["nodes"]);
});

test("alternatives follow the keys before the cursor", () => {
    assert.deepEqual(labels("nodes:\n  tb: { |"), ["kind", "cpus", "roaming"]);
    assert.deepEqual(labels("nodes:\n  tb: { kind: |"), ["robot", "switch"]);
    assert.deepEqual(labels("nodes:\n  lan: { kind: switch, |"), []);
    assert.deepEqual(labels("nodes:\n  tb: { kind: robot, |"), ["cpus", "roaming"]);
    assert.deepEqual(labels("nodes:\n  tb:\n    kind: robot\n    roaming: i|"), ["instructed"]);
    assert.deepEqual(labels("nodes:\n  lan: { kind: switch }\n  tb:\n    kind: robot\n    |"), ["cpus", "roaming"]);
});

test("lists in lines and in brackets, at any indentation", () => {
    assert.deepEqual(labels("links:\n  - |"), ["ends", "delay", "up"]);
    assert.deepEqual(labels("links:\n- ends: [a, b]\n  |"), ["delay", "up"]);
    assert.deepEqual(labels("links:\n- { ends: [a, b], delay: |"), ["5 ms"]);
    assert.deepEqual(labels("links:\n- { ends: [a,\n    b],\n    up: |"), ["true", "false"]);
    assert.deepEqual(labels("links: # wires\n  - ends: [a, b] # one\n  - d|"), ["delay"]);
    assert.deepEqual(labels("links:\n- ends: [a, b]\nn|"), ["name", "nodes"]);
});

test("names of the file are completed where they are meant", () => {
    const file = `domains: [one, two-b] # three
wireless: { lab: { delay: 1 ms } }
wireless:
  hall:
    delay: 1 ms
nodes:
  # ghost: { kind: robot }
  tb: { kind: robot, cpus: 2 } # kind: switch
  drone:
    cpus: 1
    kind: robot
  lan: { kind: switch }
  fog: { kind: server }
services:
  navigation:
    robot: tb
    vnfs:
      driver: { program: robot_driver }
      brain: { program: navigation }
`;
    const names = declared(file);
    assert.deepEqual(names.map(({ name, kind }) => `${name} ${kind}`), [
        "one domain", "two-b domain", "hall network", "tb robot", "drone robot", "lan switch", "fog server", "driver VNF", "brain VNF",
    ]);
    const at = (text) => suggest({}, locate(text), names).map(({ insert }) => insert);
    assert.deepEqual(at("links:\n  - { ends: [tb, "), ["tb", "drone", "lan", "fog"]);
    assert.deepEqual(at("links:\n  - { ends: [tb, [f"), ["fog"]);
    assert.deepEqual(at("links:\n  - ends:\n    - l"), ["lan"]);
    assert.deepEqual(at("services:\n  s:\n    robot: "), ["tb", "drone"]);
    assert.deepEqual(at("services:\n  s:\n    vnfs:\n      v: { pinned_to: "), ["tb", "drone", "fog"]);
    assert.deepEqual(at("services:\n  s:\n    virtual_links:\n      - { from: driver, to: b"), ["brain"]);
    assert.deepEqual(at("services:\n  s:\n    kpis:\n      flow: { from: "), ["tb", "drone", "fog"]);
    assert.deepEqual(at("walks:\n  tb: {}\n  "), ["drone: "]);
    assert.deepEqual(at("nodes:\n  tb: { domain: t"), ["two-b"]);
    const cased = suggest({}, locate("links:\n  - { ends: [R"), declared("nodes:\n  robot: { kind: robot }\n  R1: { kind: radio_unit }"));
    assert.deepEqual(cased.map(({ label }) => label), ["R1", "robot"], "those in the typed case come first");
    for (const other of ["nodes:\n  ", "nodes:\n  robot: { ", "nodes:\n  tb: { driver: { domain: ", "walks:\n  tb: { ", "name: "]) assert.deepEqual(at(other), [], other);
});

test("nothing in comments, and names that the file invents are free", () => {
    assert.equal(labels("name: x # n|"), null);
    assert.deepEqual(labels("nodes:\n  |"), []);
});

test("a key brings its colon, and says what it is for", () => {
    const [delay] = suggest(schema, locate("links:\n  - de"));
    assert.deepEqual(delay, { label: "delay", insert: "delay: ", detail: "Time." });
});

test("any beginning of a text is located or not, without an error", () => {
    const text = "nodes:\n  tb: { kind: robot, x: [1, {a: 'b' }], y: \"]\" }\n- - a: |\n  b\n: - [\n}}]\n  - c: {\n";
    for (let end = 0; end <= text.length; end++) {
        const place = locate(text.slice(0, end));
        if (place) suggest(schema, place);
    }
});
