// Actions: what a form calls, how that looks as curl and Python, and which real things it touches.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { test } from "node:test";

import { call, curl, paths, python, touches } from "../page/actions.js";
import { instruction as inWords, Model } from "../page/state.js";
import { found, links } from "../page/topology.js";

const instruction = (form) => call(form).body.instruction;
/** A change of a link in which no field is filled in. */
const UNCHANGED = { delay_ms: null, loss_percent: null, rate_mbps: null, jitter_ms: null, delay_scale: null, drop_scale: null };
const ADDRESS = "http://127.0.0.1:7700";

test("each form gives the instruction that it names", () => {
    const link = "a-b";
    for (const [form, expected] of [
        [{ action: "attach", robot: "r", radio_unit: "R1" }, { instruction: "attach", robot: "r", radio_unit: "R1" }],
        [{ action: "suggest", robot: "r", radio_unit: "R1" }, { instruction: "suggest", robot: "r", radio_unit: "R1" }],
        [{ action: "place", vnf: "v", node: "fog" }, { instruction: "place", vnf: "v", node: "fog" }],
        [{ action: "send", robot: "r", x: 1, y: -2.5, z: null }, { instruction: "navigate_to", robot: "r", goal: { x: 1, y: -2.5 } }],
        [{ action: "send", robot: "r", x: 1, y: 2, z: 3 }, { instruction: "navigate_to", robot: "r", goal: { x: 1, y: 2, z: 3 } }],
        [{ action: "return", robot: "r" }, { instruction: "navigate_to", robot: "r", goal: null }],
        [{ action: "halt", robot: "r" }, { instruction: "halt", robot: "r" }],
        [{ action: "go", robot: "r" }, { instruction: "go", robot: "r" }],
        [{ action: "scan", robot: "r", radio_unit: "R1" }, { instruction: "scan", robot: "r" }],
        [{ action: "limit", robot: "r", speed_limit_mps: 0.2 }, { instruction: "limit_speed", robot: "r", speed_limit_mps: 0.2 }],
        [{ action: "limit", robot: "r", speed_limit_mps: null }, { instruction: "limit_speed", robot: "r", speed_limit_mps: null }],
        [{ action: "map", path: '{"from":"r","to":"fog","links":["r~R1","R1-fog"]}' }, { instruction: "map", from: "r", to: "fog", links: ["r~R1", "R1-fog"] }],
        [{ action: "test", link, direction: "backward", seconds: 0.1 },
            { instruction: "test_throughput", link, direction: "backward", test: { duration_ms: 100 } }],
    ]) {
        assert.deepEqual(instruction(form), expected);
        assert.deepEqual({ ...call(form), body: null }, { method: "POST", path: "/api/v1/instructions", body: null });
    }
});

test("an empty field leaves a condition as it is", () => {
    const empty = { action: "condition", link: "l", direction: null, ...UNCHANGED };
    assert.deepEqual(instruction(empty), { instruction: "condition", link: "l", change: {} });
    const all = { ...empty, direction: "forward", delay_ms: 0, loss_percent: 0.7, rate_mbps: 2.5 };
    const change = { delay_ms: 0, loss: { kind: "independent", share: 0.007 }, rate: { kind: "fixed", rate_bps: 2_500_000 } };
    assert.deepEqual(instruction(all), { instruction: "condition", link: "l", direction: "forward", change });
    assert.deepEqual(instruction({ ...empty, loss_percent: 0 }).change, { loss: { kind: "none" } });
    const rare = instruction({ ...empty, jitter_ms: 0, delay_scale: 2, drop_scale: 4 });
    assert.deepEqual(rare.change, { jitter: { deviation_ms: 0 }, delay_scale: 2, drop_scale: 4 });
    assert.equal(inWords(rare), "change l: jitter 0 ms, ψ 2, δ 4");
    const correlated = { jitter: { deviation_ms: 2, correlation: 0.4 } };
    assert.equal(inWords({ instruction: "condition", link: "l", change: correlated }), "change l: jitter 2 ms, correlation 40.0 %");
});

test("curl and Python make the same call, whatever names contain", () => {
    const names = { radio_unit: "it's \"R$1\" \\ `x` ü😀\n" };
    const of = call({ action: "attach", robot: "r", ...names });
    const programs = `curl() { cat; echo; printf '%s\\n' "$@"; }; cotorra() { echo "socket of $*"; };`;
    const shell = spawnSync("sh", ["-c", programs + curl(of, ADDRESS)], { encoding: "utf8", env: { COTORRA_TOKEN: "of the environment" } });
    const [header, , , , socket, url, , type, , ...body] = shell.stdout.split("\n");
    assert.equal(header, 'header = "Authorization: Bearer of the environment"');
    assert.equal(socket, `socket of ps --socket --run ${new URL(ADDRESS).host}`);
    assert.deepEqual([url, type], ["http://localhost/api/v1/instructions", "Content-Type: application/json"]);
    assert.deepEqual(JSON.parse(body.join("\n")), of.body);

    const program = `
import json, sys, types
class Client:
    def __init__(self, api): self.api = api
    def instruct(self, reason=None, **instruction): print(json.dumps([self.api, {"instruction": instruction, "reason": reason}]))
sys.modules["cotorra"] = types.SimpleNamespace(Client=Client)
`;
    const forms = [
        { action: "return", robot: "r" },
        { action: "condition", link: "l", direction: null, ...UNCHANGED, delay_ms: 1.5, loss_percent: 1, rate_mbps: 2 },
    ];
    for (const each of [of, ...forms.map(call)]) {
        const { stdout, stderr } = spawnSync("python3", ["-c", program + python(each, ADDRESS)], { encoding: "utf8" });
        assert.deepEqual(stdout && JSON.parse(stdout), [ADDRESS, each.body], stderr);
    }
});

test("real interfaces, servers and robots are named", () => {
    const nodes = [
        { kind: "switch", id: "lan" },
        { kind: "robot", id: "r" },
        { kind: "robot", id: "turtle", driver: { kind: "kobuki", port: "/dev/kobuki" } },
        { kind: "robot", id: "ros", driver: { kind: "ros2" } },
        { kind: "server", id: "emulated" },
        { kind: "server", id: "fog", real: { agent: "fog1", interface: "eth1", address: "10.0.0.2" } },
        { kind: "machine", id: "plc", reached: { interface: "eth2", via: "a1" } },
        { kind: "gateway", id: "gate", interface: "eth3", netns: "plant" },
    ];
    const links = ["emulated", "fog", "plc", "gate"].map((id) => ({ id: `lan-${id}`, ends: ["lan", id] }));
    const of = (form) => touches({ graph: { nodes, links } }, form);
    const changed = (link) => of({ action: "condition", link, direction: null, ...UNCHANGED, delay_ms: 1 });
    assert.deepEqual(changed("lan-emulated"), []);
    assert.deepEqual(changed("r~R1"), []);
    assert.deepEqual(changed("lan-fog"), ["interface eth1, to server fog"]);
    assert.deepEqual(changed("lan-plc"), ["interface eth2 in the machine of agent a1, to machine plc"]);
    assert.deepEqual(of({ action: "test", link: "lan-gate", direction: "forward", seconds: 1 }), ["interface eth3 in namespace plant, of gateway gate"]);
    assert.deepEqual(of({ action: "place", vnf: "v", node: "fog" }), ["server fog, where agent fog1 starts v"]);
    assert.deepEqual(of({ action: "place", vnf: "v", node: "emulated" }), []);
    assert.match(of({ action: "send", robot: "turtle", x: 0, y: 0, z: null })[0], /\/dev\/kobuki/);
    assert.match(of({ action: "go", robot: "ros" })[0], /ROS/);
    const limit = (speed_limit_mps) => of({ action: "limit", robot: "turtle", speed_limit_mps }).length;
    assert.deepEqual([limit(0), limit(0.5), limit(null)], [0, 1, 1], "a limit that stops a robot needs no question");
    assert.deepEqual(of({ action: "halt", robot: "turtle" }), [], "nobody has to confirm a halt");
    assert.deepEqual(of({ action: "send", robot: "r", x: 0, y: 0, z: null }), []);
});

test("the paths between two nodes are those that forward packets, in both directions", () => {
    const nodes = [
        { kind: "robot", id: "robot" }, { kind: "radio_unit", id: "R1" }, { kind: "radio_unit", id: "R2" }, { kind: "switch", id: "wide" },
        { kind: "server", id: "edge" }, { kind: "server", id: "fog" },
    ];
    const wired = ["R1 edge", "R1 wide", "wide edge", "R1 fog", "fog edge", "R2 edge"].map((ends) => ({ id: ends.replace(" ", "-"), ends: ends.split(" ") }));
    const services = [{
        id: "navigation", robot: "robot", kpis: {}, virtual_links: [{ from: "driver", to: "brain", rate_bps: 1 }],
        vnfs: [{ id: "driver", node: "robot", pinned_to: "robot" }, { id: "brain", node: "fog" }],
    }];
    const model = new Model({ name: "", description: "", graph: { domains: [], wireless: {}, nodes, links: wired }, services, walks: [], plugins: [] });
    const offered = () => paths(model, links(model)).map(({ from, to, links }) => [from, to, ...links].join(" "));
    assert.deepEqual(offered(), ["robot fog", "fog robot"], "a robot without a radio unit has the shortest path alone");
    model.take({ at_ns: 1, event: "placement", vnf: "brain", node: "edge" });
    const sensors = { pose: { x: 0, y: 0 }, velocity: { linear: 0, angular: 0 } };
    model.take({ at_ns: 1, event: "robot", robot: "robot", waypoint: 0, attachments: [{ radio_unit: "R1", attached: true }], sensors });
    assert.deepEqual(offered(), [
        "robot edge", "robot edge robot~R1 R1-edge", "robot edge robot~R1 R1-wide wide-edge",
        "edge robot", "edge robot R1-edge robot~R1", "edge robot wide-edge R1-wide robot~R1",
    ]);
});

test("a click on the topology means the VNF below it, or the link near it", () => {
    const boxes = [
        { id: "robot", x: 100, y: 100, wide: 104, vnfs: ["driver", "lidar"] },
        { id: "edge", x: 400, y: 100, wide: 104, vnfs: [] },
        { id: "fog", x: 400, y: 300, wide: 104, vnfs: ["brain"] },
    ];
    const links = [{ id: "robot-edge", ends: ["robot", "edge"] }, { id: "robot-fog", ends: ["robot", "fog"] }, { id: "gone", ends: ["robot", "none"] }];
    const at = (x, y) => found(boxes, links, x, y);
    assert.deepEqual([at(100, 80), at(100, 100), at(100, 114)], [null, { vnf: "driver" }, { vnf: "lidar" }]);
    assert.deepEqual([at(400, 100), at(400, 306)], [null, { vnf: "brain" }]);
    assert.deepEqual([at(250, 105), at(250, 198), at(250, 150)], [{ link: "robot-edge" }, { link: "robot-fog" }, null]);
});
