// The state of a run in the page: a state machine without a clock, a socket or an element. Events go in, and the model has the
// last of everything, the figures over time, and what happened. All of it is bounded.

import { figure } from "./format.js";
import { Series } from "./series.js";

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {Schemas["Stamped"]} Stamped */
/** @typedef {Schemas["Service"]} Service */
/** @typedef {{ id: string, kind: string, position?: {x: number, y: number} | null }} PlacedNode */
/** @typedef {{ from: number, until: number | null, unit: string }} Region */
/**
 * @typedef {object} Entry Something that happened.
 * @property {number} at Seconds since the run began.
 * @property {string} group Key of {@link GROUPS}.
 * @property {string} title
 * @property {string} detail
 * @property {boolean} bad Whether it went wrong.
 * @property {string | null} robot
 * @property {number} number Grows with each entry.
 */

/** Kinds of events of which the timeline has all. */
export const HAPPENINGS = [
    "placement", "handover", "detached", "vnf", "decision", "plugin_fault", "goal", "walk_finished", "notice",
    "suggestion_answered", "federation_requested",
];
/** Kinds of events that the page reads. */
export const KINDS = [...HAPPENINGS, "robot", "link", "virtual_link", "service_time", "lateness", "machine"];

/** Groups of entries in the timeline. */
export const GROUPS = Object.freeze({
    handover: "Handovers",
    placement: "Placements",
    decision: "Decisions",
    goal: "Goals",
    fault: "Faults",
    notice: "Notices",
});

const MOST_ENTRIES = 4000;
const MOST_REGIONS = 2000;
const MOST_SERIES = 1000;
const TRAIL = 1500;
/** Distance between two points of a trail, metres. */
const TRAIL_STEP = 0.1;

/**
 * Returns the name of the same figure of the run that this one is compared with.
 * @param {string} figure
 */
export const other = (figure) => `other:${figure}`;

/** Parts that a service time is split into. */
export const PARTS = Object.freeze(["air", "wires", "queues", "VNF", "hosts"]);

/**
 * Splits a service time into a few parts, in milliseconds, which add up to it. What no stamp covers counts to the hosts.
 * @param {Schemas["TimeParts"]} parts
 */
export function split(parts) {
    const split = { air: 0, wires: 0, queues: 0, VNF: parts.vnf_ms, hosts: parts.sender_ms + parts.receiver_ms + parts.unknown_time_ms };
    for (const { link, queueing_ms, retries_ms, crossing_ms } of parts.links) {
        split.queues += queueing_ms;
        // The names of wireless links alone have a tilde.
        split[link.includes("~") ? "air" : "wires"] += retries_ms + crossing_ms;
    }
    return split;
}

export class Robot {
    /** @param {string} id */
    constructor(id) {
        this.id = id;
        /** κ, as of the last event. @type {Schemas["RobotContext"] | null} */
        this.context = null;
        this.at = -Infinity;
        /** Its attachments, in order. @type {Region[]} */
        this.regions = [];
        /** Places that it passed: x, y and time. @type {{x: number, y: number, at: number}[]} */
        this.trail = [];
        this.finished = false;
    }

    /** The radio unit that it is attached to. */
    get unit() {
        return this.context?.attachments.find((attachment) => attachment.attached)?.radio_unit ?? null;
    }

    /**
     * @param {number} at
     * @param {string | null} unit
     */
    attach(at, unit) {
        const last = this.regions.at(-1);
        if (last && last.until === null) {
            if (last.unit === unit) return;
            last.until = at;
        }
        if (unit !== null) this.regions.push({ from: at, until: null, unit });
        if (this.regions.length > MOST_REGIONS) this.regions.splice(0, MOST_REGIONS / 4);
    }

    /**
     * Attaches it to a radio unit, or to none, without waiting for its next report.
     * @param {number} at
     * @param {string | null} unit
     */
    handOver(at, unit) {
        this.attach(at, unit);
        if (!this.context || at < this.at) return;
        const attachments = this.context.attachments.map((one) => ({ ...one, attached: one.radio_unit === unit }));
        if (unit !== null && !attachments.some(({ attached }) => attached)) attachments.push({ radio_unit: unit, attached: true });
        this.context = { ...this.context, attachments };
    }

    /**
     * @param {number} at
     * @param {number} x
     * @param {number} y
     */
    pass(at, x, y) {
        const last = this.trail.at(-1);
        if (last && Math.hypot(x - last.x, y - last.y) < TRAIL_STEP) return;
        this.trail.push({ x, y, at });
        if (this.trail.length > TRAIL) this.trail.splice(0, TRAIL / 4);
    }
}

export class Model {
    /** @param {Schemas["TestbedBody"]} testbed */
    constructor(testbed) {
        this.testbed = testbed;
        /** Seconds since the run began, of the last event. */
        this.now = 0;
        /** @type {Map<string, PlacedNode>} */
        this.nodes = new Map(testbed.graph.nodes.map((node) => [node.id, /** @type {PlacedNode} */ (node)]));
        /** Names of radio units, in the file's order, which gives them their colours. */
        this.units = testbed.graph.nodes.filter((node) => node.kind === "radio_unit").map((node) => node.id);
        /** @type {Map<string, Robot>} */
        this.robots = new Map();
        for (const node of testbed.graph.nodes) {
            if (node.kind === "robot") this.robots.set(node.id, new Robot(node.id));
        }
        /** The last context of each direction of a link, by `LINK:DIRECTION`. @type {Map<string, Schemas["LinkContext"]>} */
        this.links = new Map();
        /** The last throughput test of each direction, with its end. @type {Map<string, { at: number, throughput_bps: number, offered_bps: number }>} */
        this.tests = new Map();
        /** Nodes of VNFs. @type {Map<string, string[]>} */
        this.placements = new Map();
        /** @type {Map<string, Schemas["VirtualLinkMapping"]>} */
        this.virtualLinks = new Map();
        /** @type {Map<string, Schemas["MachineContext"]>} */
        this.machines = new Map();
        /** Figures over time, by their names in the API. @type {Map<string, Series>} */
        this.series = new Map();
        /** A stretch that was read closely. @type {{ from: number, until: number, series: Map<string, Series> } | null} */
        this.detail = null;
        /** Whether figures of another run are known, too. */
        this.isCompared = false;
        /** @type {Schemas["Lateness"] | null} */
        this.lateness = null;
        /** @type {Entry[]} */
        this.entries = [];
        this.lastEntry = 0;
        /** Events that the stream lost. */
        this.missed = 0;
        /** Grows when something else has to be drawn: robots, figures, entries, the network. */
        this.version = { robots: 0, figures: 0, entries: 0, network: 0 };
        /** Keys of entries at the same time as the last, so that none is added twice. @type {Set<string>} */
        this.known = new Set();
    }

    /**
     * Returns a figure over time; a new one is empty.
     * @param {string} name
     */
    figure(name) {
        let series = this.series.get(name);
        if (!series) {
            series = new Series();
            if (this.series.size < MOST_SERIES) this.series.set(name, series);
        }
        return series;
    }

    /**
     * Takes over the state at a time.
     * @param {Schemas["GraphState"]} state
     */
    begin(state) {
        for (const { at_ns, ...robot } of state.robots) this.#robot(at_ns / 1e9, robot);
        for (const { at_ns, ...link } of state.links) this.#link(at_ns / 1e9, link);
        for (const { at_ns: _, ...placement } of state.placements) this.#place(placement);
        for (const { at_ns: _, ...mapping } of state.virtual_links) this.#map(mapping);
        for (const { at_ns, ...machine } of state.machines ?? []) this.#machine(at_ns / 1e9, machine);
        this.now = Math.max(this.now, state.at_ns / 1e9);
        // Without a handover, a robot is where it was when the run began.
        for (const { regions } of this.robots.values()) {
            if (regions.length === 1 && regions[0].until === null && this.entries.every(({ group }) => group !== "handover")) regions[0].from = 0;
        }
    }

    /**
     * Returns a figure as closely as it is known in a stretch of time.
     * @param {string} name
     * @param {number} from
     * @param {number} until
     */
    closest(name, from, until) {
        const { detail } = this;
        const isWithin = detail && detail.from <= from && detail.until >= until;
        return (isWithin ? detail.series.get(name) : undefined) ?? this.figure(name);
    }

    /**
     * Takes over a figure of the run that this one is compared with.
     * @param {Schemas["Curve"]} curve
     */
    recallOther(curve) {
        this.isCompared = true;
        this.recall({ ...curve, figure: other(curve.figure) });
    }

    /**
     * Takes over a figure of the history.
     * @param {Schemas["Curve"]} curve
     */
    recall(curve) {
        this.figure(curve.figure).addCurve(curve);
        this.version.figures += 1;
    }

    /**
     * Takes over where a robot went, by the figures of its position.
     * @param {string} id
     * @param {Schemas["Curve"]} xs
     * @param {Schemas["Curve"]} ys
     */
    recallTrail(id, xs, ys) {
        const robot = this.robots.get(id);
        if (!robot) return;
        const length = Math.min(xs.points.length, ys.points.length);
        const before = robot.trail;
        robot.trail = [];
        for (let i = 0; i < length; i++) {
            const [x, y] = [xs.points[i], ys.points[i]];
            if ("last" in x && "last" in y) robot.pass(x.until_ns / 1e9, x.last, y.last);
        }
        const last = robot.trail.at(-1)?.at ?? -Infinity;
        for (const { x, y, at } of before) if (at > last) robot.pass(at, x, y);
        this.version.robots += 1;
    }

    /**
     * Takes over an event of the history, which was before the state.
     * @param {Stamped} event
     */
    recount(event) {
        const at = event.at_ns / 1e9;
        if (event.event === "handover") {
            const robot = this.robots.get(event.robot);
            if (robot && robot.regions.length === 0 && event.from) robot.attach(0, event.from);
            robot?.attach(at, event.to);
        }
        if (event.event === "detached") this.robots.get(event.robot)?.attach(at, null);
        if (event.event === "walk_finished") this.#finish(event.robot);
        this.#enter(event);
    }

    /**
     * Takes an event.
     * @param {Stamped} event
     */
    take(event) {
        const at = event.at_ns / 1e9;
        this.now = Math.max(this.now, at);
        switch (event.event) {
            case "robot": {
                this.#robot(at, event);
                return;
            }
            case "link": {
                this.#link(at, event);
                return;
            }
            case "service_time": {
                this.#sample(at, event);
                return;
            }
            case "machine": {
                this.#machine(at, event);
                return;
            }
            case "lateness": {
                this.lateness = event;
                return;
            }
            case "virtual_link": {
                this.#map(event);
                return;
            }
            case "placement": {
                this.#place(event);
                break;
            }
            case "handover":
            case "detached": {
                this.robots.get(event.robot)?.handOver(at, event.event === "handover" ? event.to : null);
                this.version.robots += 1;
                break;
            }
            case "vnf": {
                if (event.state === "started" && !this.placements.has(event.vnf)) {
                    this.#place({ vnf: event.vnf, node: event.node });
                }
                break;
            }
            case "walk_finished": {
                this.#finish(event.robot);
                break;
            }
        }
        this.#enter(event);
    }

    /**
     * @param {number} at
     * @param {Schemas["RobotContext"]} context
     */
    #robot(at, context) {
        const robot = this.robots.get(context.robot);
        if (!robot || at < robot.at) return;
        const { x, y } = context.sensors.pose;
        robot.context = context;
        robot.at = at;
        robot.pass(at, x, y);
        // A handover has an event of its own, at its exact time. Where the run began, there was none.
        if (robot.regions.length === 0 && robot.unit) robot.attach(at, robot.unit);
        for (const { radio_unit, attached, signal_dbm, signal_age_ms } of context.attachments) {
            // A signal counts once, where it was heard. Contexts come every 100 ms.
            const isNews = attached || (signal_age_ms ?? 0) <= 100;
            if (isNews && signal_dbm !== null && signal_dbm !== undefined) {
                this.figure(`signal:${context.robot}:${radio_unit}`).add(at, signal_dbm);
            }
        }
        const error = context.localization_error_m;
        if (error !== null && error !== undefined) this.figure(`localization_error:${context.robot}`).add(at, error);
        this.version.robots += 1;
    }

    /**
     * @param {number} at
     * @param {Schemas["LinkContext"]} context
     */
    #link(at, context) {
        const of = `${context.link}:${context.direction}`;
        this.links.set(of, context);
        if (context.tested) this.tests.set(of, { at: at - context.tested.age_ms / 1e3, ...context.tested });
        // Without a packet there is no delay; the chart breaks the line when there is none for long.
        if (context.delay_ms !== null && context.delay_ms !== undefined) this.figure(`delay:${of}`).add(at, context.delay_ms);
        this.version.network += 1;
        this.version.figures += 1;
    }

    /** @param {Schemas["Placement"]} placement */
    #place({ vnf, node }) {
        this.placements.set(vnf, Array.isArray(node) ? node : [node]);
        this.version.network += 1;
    }

    /** @param {Schemas["VirtualLinkMapping"]} mapping */
    #map(mapping) {
        this.virtualLinks.set(`${mapping.from} ${mapping.to}`, mapping);
        this.version.network += 1;
    }

    /**
     * @param {number} at
     * @param {Schemas["MachineContext"]} context
     */
    #machine(at, context) {
        this.machines.set(context.node, context);
        const busy = context.cpu?.busy;
        if (busy !== null && busy !== undefined) this.figure(`cpu:${context.node}`).add(at, busy);
        if (context.memory) this.figure(`available_memory:${context.node}`).add(at, context.memory.available_bytes);
        this.version.figures += 1;
    }

    /**
     * @param {number} at
     * @param {Schemas["ServiceTime"]} sample
     */
    #sample(at, sample) {
        this.figure(`service_time:${sample.service}`).add(at, sample.service_time_ms ?? NaN);
        if (sample.parts) {
            for (const [part, ms] of Object.entries(split(sample.parts))) this.figure(`split:${sample.service}:${part}`).add(at, ms);
        }
        this.version.figures += 1;
    }

    /** @param {string} id */
    #finish(id) {
        const robot = this.robots.get(id);
        if (robot) robot.finished = true;
        this.version.robots += 1;
    }

    /** @param {Stamped} event */
    #enter(event) {
        const words = describe(event);
        if (!words) return;
        const at = event.at_ns / 1e9;
        const last = this.entries.at(-1);
        if (last && at < last.at) return;
        if (!last || at > last.at) this.known.clear();
        const key = `${words.title} ${words.detail}`;
        if (this.known.has(key)) return;
        this.known.add(key);
        this.lastEntry += 1;
        this.entries.push({ at, bad: false, robot: null, ...words, number: this.lastEntry });
        if (this.entries.length > MOST_ENTRIES) this.entries.splice(0, MOST_ENTRIES / 4);
        this.version.entries += 1;
    }
}

/**
 * Returns an event in words; `null` for one that is not in the timeline.
 * @param {Stamped} event
 * @returns {{ group: string, title: string, detail: string, bad?: boolean, robot?: string } | null}
 */
export function describe(event) {
    switch (event.event) {
        case "handover": {
            const gap = `${event.gap_ms.toFixed(1)} ms without a radio unit${event.fast ? ", fast transition" : ""}`;
            return { group: "handover", title: `${event.robot}: ${event.from ?? "none"} → ${event.to}`, detail: gap, robot: event.robot };
        }
        case "detached":
            return { group: "handover", title: `${event.robot} has no radio unit`, detail: "", bad: true, robot: event.robot };
        case "suggestion_answered": {
            const { robot, radio_unit, status } = event;
            const moves = status === 0;
            return { group: "handover", title: `${robot} ${moves ? "moves" : "does not move"} to ${radio_unit}`, detail: moves ? "as suggested" : `status ${status}`, bad: !moves, robot };
        }
        case "federation_requested":
            return { group: "handover", title: `the brain of ${event.robot} requests a federation`, detail: "", robot: event.robot };
        case "placement":
            return { group: "placement", title: `${event.vnf} on ${[event.node].flat().join(", ")}`, detail: "answers from there" };
        case "vnf": {
            const bad = event.state === "died" || event.state === "failed";
            return { group: bad ? "fault" : "placement", title: `${event.vnf} ${event.state} on ${event.node}`, detail: event.detail ?? "", bad };
        }
        case "decision": {
            const refused = event.refused ?? null;
            const why = [event.reason, refused && `refused: ${refused}`].filter(Boolean).join("; ");
            return { group: "decision", title: `${event.plugin}: ${instruction(event.instruction)}`, detail: why, bad: refused !== null };
        }
        case "goal": {
            if (event.state === "progress") return null;
            const at = `(${event.goal.x.toFixed(1)}, ${event.goal.y.toFixed(1)})`;
            return { group: "goal", title: `${event.robot}: goal ${at} ${event.state}`, detail: event.reason ?? "", bad: event.state === "failed", robot: event.robot };
        }
        case "walk_finished":
            return { group: "goal", title: `${event.robot} is at the end of its walk`, detail: "", robot: event.robot };
        case "plugin_fault":
            return { group: "fault", title: `${event.plugin} was cut off`, detail: event.reason, bad: true };
        case "notice":
            return { group: "notice", title: event.message, detail: "" };
        default:
            return null;
    }
}

/**
 * Returns the figures of a change in words.
 * @param {Schemas["ConditionChange"]} change
 */
function changes({ delay_ms, jitter, loss, rate, delay_scale, drop_scale }) {
    const scaled = (/** @type {string} */ name, /** @type {number | null | undefined} */ scale) => (scale === null || scale === undefined ? "" : `${name} ${scale}`);
    const words = [
        delay_ms === null || delay_ms === undefined ? "" : `delay ${delay_ms} ms`,
        jitter ? `jitter ${jitter.deviation_ms} ms` : "",
        jitter?.correlation ? `correlation ${figure(jitter.correlation * 100, "%")}` : "",
        loss ? `loss ${"share" in loss ? figure(loss.share * 100, "%") : "none"}` : "",
        rate ? `rate ${rate.kind === "fixed" ? figure(rate.rate_bps, "bit/s") : rate.kind}` : "",
        scaled("ψ", delay_scale),
        scaled("δ", drop_scale),
    ].filter(Boolean);
    return words.length > 0 ? `: ${words.join(", ")}` : "";
}

/**
 * Returns an instruction in words.
 * @param {Schemas["Instruction"]} given
 */
export function instruction(given) {
    switch (given.instruction) {
        case "attach": return `attach ${given.robot} to ${given.radio_unit}`;
        case "suggest": return `suggest ${given.radio_unit} to ${given.robot}`;
        case "place": return `place ${given.vnf} on ${[given.node].flat().join(", ")}`;
        case "move": return `move ${given.robot}`;
        case "navigate_to": return given.goal ? `send ${given.robot} to (${given.goal.x.toFixed(1)}, ${given.goal.y.toFixed(1)})` : `send ${given.robot} back to its walk`;
        case "limit_speed": {
            const { robot, speed_limit_mps: limit } = given;
            return limit === null || limit === undefined ? `lift the speed limit of ${robot}` : `limit ${robot} to ${limit} m/s`;
        }
        case "condition": return `change ${given.link}${given.direction ? ` ${given.direction}` : ""}${changes(given.change)}`;
        case "map": return `map ${given.from} → ${given.to} over ${given.links.join(", ") || "the shortest path"}`;
        case "test_throughput": return `test ${given.link} ${given.direction}`;
        case "note": return "note";
        default: {
            const of = "robot" in given ? given.robot : "radio_unit" in given ? given.radio_unit : "";
            return `${given.instruction.replaceAll("_", " ")} ${of}`.trim();
        }
    }
}
