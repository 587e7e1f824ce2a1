// The actions of the page on a run: from a filled-in form to a call of the API, and the same call as curl and Python.

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {Schemas["Direction"]} Direction */
/**
 * @typedef {{ action: "attach" | "suggest", robot: string, radio_unit: string }
 *     | { action: "place", vnf: string, node: string }
 *     | { action: "send", robot: string, x: number, y: number, z: number | null }
 *     | { action: "return" | "halt" | "go" | "scan", robot: string }
 *     | { action: "limit", robot: string, speed_limit_mps: number | null }
 *     | { action: "map", path: string }
 *     | { action: "condition", link: string, direction: Direction | null } & Change
 *     | { action: "test", link: string, direction: Direction, seconds: number }} Form
 *   What somebody filled in. `null` is an empty field.
 */
/**
 * @typedef {{ delay_ms: number | null, loss_percent: number | null, rate_mbps: number | null, jitter_ms: number | null,
 *     delay_scale: number | null, drop_scale: number | null }} Change
 */
/** @typedef {{ from: string, to: string, links: string[] }} Path Links from one node to another; none for the shortest path. */
/** @typedef {{ method: "POST", path: string, body: Schemas["InstructionBody"] }} Call */

/** Paths that are offered, in all. */
const MOST_PATHS = 100;
/** Routes that are offered between two nodes. */
const MOST_ROUTES = 6;
/** Steps of the search for them. */
const MOST_STEPS = 500;

/** Recorded with each decision. */
const REASON = "by hand";

/**
 * Returns the call that does what a form says.
 * @param {Form} form
 * @returns {Call}
 */
export function call(form) {
    return { method: "POST", path: "/api/v1/instructions", body: { instruction: instruct(form), reason: REASON } };
}

/**
 * @param {Form} form
 * @returns {Schemas["Instruction"]}
 */
function instruct(form) {
    switch (form.action) {
        case "attach": return { instruction: "attach", robot: form.robot, radio_unit: form.radio_unit };
        case "suggest": return { instruction: "suggest", robot: form.robot, radio_unit: form.radio_unit };
        case "place": return { instruction: "place", vnf: form.vnf, node: form.node };
        case "send": {
            const { x, y, z } = form;
            return { instruction: "navigate_to", robot: form.robot, goal: z === null ? { x, y } : { x, y, z } };
        }
        case "return": return { instruction: "navigate_to", robot: form.robot, goal: null };
        case "halt": return { instruction: "halt", robot: form.robot };
        case "go": return { instruction: "go", robot: form.robot };
        case "scan": return { instruction: "scan", robot: form.robot };
        case "limit": return { instruction: "limit_speed", robot: form.robot, speed_limit_mps: form.speed_limit_mps };
        case "map": return { instruction: "map", .../** @type {Path} */ (JSON.parse(form.path)) };
        case "condition": {
            const { link, direction } = form;
            const of = direction === null ? { link } : { link, direction };
            return { instruction: "condition", ...of, change: change(form) };
        }
        case "test": {
            const { link, direction, seconds } = form;
            return { instruction: "test_throughput", link, direction, test: { duration_ms: round(seconds * 1000) } };
        }
    }
}

/**
 * @param {Change} form
 * @returns {Schemas["ConditionChange"]}
 */
function change({ delay_ms, loss_percent, rate_mbps, jitter_ms, delay_scale, drop_scale }) {
    /** @type {Schemas["ConditionChange"]} */
    const wanted = {};
    if (delay_ms !== null) wanted.delay_ms = delay_ms;
    if (loss_percent !== null) wanted.loss = loss_percent === 0 ? { kind: "none" } : { kind: "independent", share: round(loss_percent / 100) };
    if (rate_mbps !== null) wanted.rate = { kind: "fixed", rate_bps: Math.round(rate_mbps * 1e6) };
    if (jitter_ms !== null) wanted.jitter = { deviation_ms: jitter_ms };
    if (delay_scale !== null) wanted.delay_scale = delay_scale;
    if (drop_scale !== null) wanted.drop_scale = drop_scale;
    return wanted;
}

/**
 * Rounds away what binary fractions add, as in 0.7 / 100.
 * @param {number} value
 */
const round = (value) => Number(value.toPrecision(12));

/**
 * Returns a call as a command for a shell of the run's user, over the run's socket. A token of the shell's environment goes
 * through a pipe, because every user of a machine can see arguments.
 * @param {Call} of
 * @param {string} address
 */
export function curl({ path, body }, address) {
    const quoted = (/** @type {string} */ text) => (/^[\w:/.-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
    const { protocol, host } = new URL(address);
    return [
        `printf 'header = "Authorization: Bearer %s"' "$COTORRA_TOKEN" | curl -K -`,
        `--unix-socket "$(cotorra ps --socket --run ${quoted(host)})"`,
        quoted(`${protocol}//localhost${path}`),
        "-H 'Content-Type: application/json'",
        `-d ${quoted(JSON.stringify(body, null, 2))}`,
    ].join(" \\\n  ");
}

/**
 * Returns a call as a program with clients/python/cotorra.py, which takes the token from COTORRA_TOKEN.
 * @param {Call} of
 * @param {string} address
 */
export function python({ body }, address) {
    const { instruction, reason } = body;
    const words = Object.entries(instruction).map(([name, value]) => `${name}=${literal(value)}`);
    const given = [literal(reason), ...words].map((word) => `    ${word},`).join("\n");
    return `from cotorra import Client\n\nClient(${literal(address)}).instruct(\n${given}\n)`;
}

/**
 * Returns a value as Python writes it.
 * @param {unknown} value
 * @returns {string}
 */
function literal(value) {
    if (value === null || value === undefined) return "None";
    if (typeof value === "boolean") return value ? "True" : "False";
    if (Array.isArray(value)) return `[${value.map(literal).join(", ")}]`;
    if (typeof value === "object") return `{${Object.entries(value).map(([name, one]) => `${literal(name)}: ${literal(one)}`).join(", ")}}`;
    // Python reads numbers and strings of JSON.
    return JSON.stringify(value);
}

/**
 * Returns the paths that packets between two VNFs of a service can take, in either direction: for each pair of nodes the
 * shortest, which follows the delays, and then those with the fewest links.
 * @param {import("./state.js").Model} model
 * @param {{ id: string, ends: [string, string] }[]} links Links that there are now.
 * @returns {Path[]}
 */
export function paths(model, links) {
    const vnfs = new Map(model.testbed.services.flatMap(({ vnfs }) => vnfs).map((vnf) => [vnf.id, vnf]));
    const nodesOf = (/** @type {string} */ id) => model.placements.get(id) ?? [vnfs.get(id)?.node ?? []].flat();
    /** @type {Map<string, [string, string]>} */
    const pairs = new Map();
    for (const { from, to } of model.testbed.services.flatMap(({ virtual_links }) => virtual_links)) {
        for (const one of nodesOf(from)) for (const other of nodesOf(to)) {
            if (one === other) continue;
            for (const pair of /** @type {[string, string][]} */ ([[one, other], [other, one]])) pairs.set(pair.join(" "), pair);
        }
    }
    /** @type {Map<string, { id: string, next: string }[]>} */
    const beside = new Map();
    for (const { id, ends: [one, other] } of links) {
        for (const [at, next] of [[one, other], [other, one]]) beside.set(at, [...(beside.get(at) ?? []), { id, next }]);
    }
    const forwards = (/** @type {string} */ id) => ["radio_unit", "switch"].includes(model.nodes.get(id)?.kind ?? "");
    /** @type {Path[]} */
    const all = [];
    for (const [from, to] of pairs.values()) {
        all.push({ from, to, links: [] }, ...routes(beside, forwards, from, to).map((links) => ({ from, to, links })));
        if (all.length >= MOST_PATHS) break;
    }
    return all.slice(0, MOST_PATHS);
}

/**
 * Returns the routes with the fewest links from one node to another, without a node twice, over nodes that forward packets.
 * @param {Map<string, { id: string, next: string }[]>} beside Links of each node.
 * @param {(node: string) => boolean} forwards
 * @param {string} from
 * @param {string} to
 */
function routes(beside, forwards, from, to) {
    /** @type {string[][]} */
    const found = [];
    const open = [{ nodes: [from], over: /** @type {string[]} */ ([]) }];
    for (let i = 0; i < open.length && i < MOST_STEPS && found.length < MOST_ROUTES; i++) {
        const { nodes, over } = open[i];
        for (const { id, next } of beside.get(nodes[nodes.length - 1]) ?? []) {
            if (next === to) found.push([...over, id]);
            else if (!nodes.includes(next) && forwards(next)) open.push({ nodes: [...nodes, next], over: [...over, id] });
        }
    }
    return found.slice(0, MOST_ROUTES);
}

/**
 * Returns the real interfaces, machines and robots that a form touches, in words. Halting needs no question.
 * @param {Schemas["TestbedBody"]} testbed
 * @param {Form} form
 * @returns {string[]}
 */
export function touches({ graph }, form) {
    const node = (/** @type {string} */ id) => graph.nodes.find((one) => one.id === id);
    switch (form.action) {
        case "condition":
        case "test": {
            const ends = graph.links.find(({ id }) => id === form.link)?.ends ?? [];
            return ends.flatMap((end) => interfaceOf(node(end)) ?? []);
        }
        case "place": {
            const to = node(form.node);
            return to?.kind === "server" && to.real ? [`server ${to.id}, where agent ${to.real.agent} starts ${form.vnf}`] : [];
        }
        case "send":
        case "return":
        case "go":
        case "limit": {
            // The limit 0 stops a robot at once; a higher one may let it go.
            if (form.action === "limit" && form.speed_limit_mps === 0) return [];
            const robot = node(form.robot);
            const driver = robot?.kind === "robot" ? robot.driver : undefined;
            if (driver?.kind === "kobuki") return [`robot ${form.robot}, a TurtleBot 2 at ${driver.port}, which moves`];
            const inRos = driver?.kind === "ros1" || driver?.kind === "ros2";
            return inRos ? [`robot ${form.robot}, which is in ROS and may be a real one that moves`] : [];
        }
        default: return [];
    }
}

/**
 * Returns the real interface at a node, in words.
 * @param {Schemas["Node"] | undefined} node
 */
function interfaceOf(node) {
    const at = (/** @type {string} */ name, /** @type {string | null | undefined} */ place) => `interface ${name}${place ? ` in ${place}` : ""}`;
    switch (node?.kind) {
        case "machine": {
            const { reached } = node;
            return reached ? `${at(reached.interface, reached.via && `the machine of agent ${reached.via}`)}, to machine ${node.id}` : `machine ${node.id}`;
        }
        case "server": return node.real ? `${at(node.real.interface, node.real.netns && `namespace ${node.real.netns}`)}, to server ${node.id}` : null;
        case "gateway": return `${at(node.interface, node.netns && `namespace ${node.netns}`)}, of gateway ${node.id}`;
        default: return null;
    }
}
