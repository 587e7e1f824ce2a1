// Another time than the present: which requests are made, and what is shown then.

import assert from "node:assert/strict";
import { test } from "node:test";

import { earlier, Latest } from "../page/moment.js";
import { Model } from "../page/state.js";

/** Loads nothing until it is told to. */
function loader() {
    const asked = [];
    const shown = [];
    const failed = [];
    const load = (key) => new Promise((resolve, reject) => asked.push({ key, resolve, reject }));
    const latest = new Latest(load, (result, key) => shown.push([key, result]), (error) => failed.push(error.message));
    return { asked, shown, failed, latest };
}
const settled = () => new Promise((resolve) => setImmediate(resolve));

test("one request is under way, and the last that was wanted comes next", async () => {
    const { asked, shown, latest } = loader();
    for (const key of [1, 2, 3, 4]) latest.want(key);
    assert.deepEqual(asked.map(({ key }) => key), [1]);
    asked[0].resolve("first");
    await settled();
    assert.deepEqual(asked.map(({ key }) => key), [1, 4]);
    asked[1].resolve("last");
    await settled();
    assert.deepEqual(shown, [[1, "first"], [4, "last"]]);
    latest.want(5);
    assert.equal(asked.length, 3);
});

test("what is forgotten is not shown, and a failure does not end it", async () => {
    const { asked, shown, failed, latest } = loader();
    latest.want(1);
    latest.want(2);
    latest.forget();
    asked[0].resolve("late");
    await settled();
    assert.deepEqual([asked.length, shown], [1, []]);
    latest.want(3);
    asked[1].reject(new Error("no history"));
    await settled();
    latest.want(4);
    asked[2].resolve("there");
    await settled();
    assert.deepEqual([failed, shown], [["no history"], [[4, "there"]]]);
});

test("an earlier time has the state, trail, attachment and service time of then", () => {
    const testbed = {
        graph: { nodes: [{ id: "r", kind: "robot" }, { id: "A", kind: "radio_unit" }, { id: "B", kind: "radio_unit" }], links: [] },
        services: [{ id: "walk", robot: "r", vnfs: [], kpis: {} }], walks: [],
    };
    const live = new Model(testbed);
    const context = (x, unit) => ({
        robot: "r", attachments: [{ radio_unit: unit, attached: true, signal_dbm: -50 }],
        sensors: { pose: { x, y: 0, heading: 0, covariance: [] }, velocity: { linear: 1 } },
    });
    for (let second = 1; second <= 10; second++) {
        const at_ns = second * 1e9;
        live.take({ at_ns, event: "robot", ...context(second, second < 6 ? "A" : "B") });
        if (second === 6) live.take({ at_ns, event: "handover", robot: "r", from: "A", to: "B", gap_ms: 10 });
        live.take({ at_ns, event: "service_time", service: "walk", service_time_ms: second });
    }
    const state = { at_ns: 4e9, robots: [{ at_ns: 4e9, ...context(4, "A") }], links: [], placements: [{ at_ns: 0, vnf: "v", node: "n" }], virtual_links: [] };
    const then = earlier(live, state, 4.5);
    const robot = then.robots.get("r");
    assert.equal(robot.context.sensors.pose.x, 4);
    assert.equal(robot.unit, "A");
    assert.deepEqual(robot.trail.map(({ x }) => x), [1, 2, 3, 4]);
    assert.deepEqual(robot.regions.map(({ unit, until }) => [unit, until]), [["A", null]]);
    assert.deepEqual([then.now, then.figure("service_time:walk").last, then.placements.get("v")], [4.5, 4, ["n"]]);
    assert.equal(live.now, 10);
});
