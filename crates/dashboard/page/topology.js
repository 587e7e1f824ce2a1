// The topology: nodes in columns from robots to servers, links between them, VNFs on the nodes, and the links that carry
// virtual links, with their delay, throughput, loss and queue.

import { Canvas, FONT, rimmed } from "./canvas.js";
import { rarely } from "./dom.js";
import { BANDS, faded } from "./palette.js";
import { figure } from "./format.js";

/** @typedef {import("./state.js").Model} Model */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {{ id: string, x: number, y: number, wide: number, vnfs: string[] }} Box */
/** @typedef {{ id: string, ends: [string, string] }} Link */
/** @typedef {{ x: number, y: number, high: number }} Taken The middle of a link's figures, and their height, pixels. */

const ROW = 14;
/** Width of a node, at most and at least, and the distance between two columns, at least, pixels. */
const WIDEST = 104;
const NARROWEST = 52;
const GAP = 16;
const MARGIN = 12;
/** Distance to a link at which a click means it, pixels. */
const NEAR = 8;
/** Places for the figures of a link on it, as shares of its length, the best first. */
const SHARES = [0.5, 0.42, 0.58, 0.34, 0.66, 0.28, 0.72];
/** Places beside those, pixels. */
const BESIDE = [[0, 0], [-20, 0], [20, 0], [0, -36], [0, 36]];
/** Places of a column of nodes, as shares of its room above and below the middle, the best first. */
const SHIFTS = [0, -0.25, 0.25, -0.5, 0.5, -0.75, 0.75, -1, 1];
/** Columns of nodes, by kind. Servers stand in the order of their distance from the robots. */
const COLUMNS = ["robot", "radio_unit", "switch", "server", "gateway", "machine"];
const TIERS = ["fog", "edge", "cloud"];

/**
 * Returns the columns of nodes from left to right, without empty ones.
 * @param {Model} model
 */
export function columns(model) {
    const tier = (/** @type {import("./state.js").PlacedNode & { tier?: string }} */ node) => TIERS.indexOf(node.tier ?? "");
    const all = COLUMNS.map((kind) => [...model.nodes.values()].filter((node) => node.kind === kind));
    for (const nodes of all) nodes.sort((one, other) => tier(one) - tier(other));
    return all.filter((nodes) => nodes.length > 0).map((nodes) => nodes.map(({ id }) => id));
}

/**
 * Returns the VNFs of each node.
 * @param {Model} model
 */
export function vnfsByNode(model) {
    /** @type {Map<string, string[]>} */
    const by = new Map();
    const add = (/** @type {string} */ node, /** @type {string} */ vnf) => by.set(node, [...(by.get(node) ?? []), vnf]);
    const known = new Set(model.placements.keys());
    for (const { vnfs } of model.testbed.services) {
        for (const vnf of vnfs) if (vnf.pinned_to && !known.has(vnf.id)) add(vnf.pinned_to, vnf.id);
    }
    for (const [vnf, nodes] of model.placements) for (const node of nodes) add(node, vnf);
    return by;
}

/**
 * @param {Model} model
 * @returns {Link[]}
 */
const wired = (model) => model.testbed.graph.links.map(({ id, ends }) => /** @type {Link} */ ({ id, ends }));

/**
 * Returns the links: wired ones, and those of robots to their radio units.
 * @param {Model} model
 * @returns {Link[]}
 */
export function links(model) {
    const wireless = [...model.robots.values()].filter((robot) => robot.unit !== null);
    return [...wired(model), ...wireless.map(({ id, unit }) => /** @type {Link} */ ({ id: `${id}~${unit}`, ends: [id, unit] }))];
}

/**
 * Returns the links that carry virtual links.
 * @param {Model} model
 */
export function carrying(model) {
    return new Set([...model.virtualLinks.values()].flatMap((mapping) => mapping.links));
}

/**
 * Returns the nodes with their places. A column stands where the fewest links pass behind its nodes, so that none seems to lead
 * to a node that it only passes.
 * @param {string[][]} columns
 * @param {Map<string, string[]>} vnfs VNFs of each node.
 * @param {Link[]} links
 * @param {{ width: number, height: number }} size
 */
export function places(columns, vnfs, links, { width, height: high }) {
    /** @type {Map<string, Box>} */
    const boxes = new Map();
    const wide = Math.max(NARROWEST, Math.min(WIDEST, (width - 2 * MARGIN - GAP * (columns.length - 1)) / columns.length));
    const inner = width - 2 * MARGIN - wide;
    columns.forEach((nodes, column) => {
        const x = MARGIN + wide / 2 + (columns.length > 1 ? (inner * column) / (columns.length - 1) : inner / 2);
        nodes.forEach((id, row) => boxes.set(id, { id, x, y: (high * (row + 0.5)) / nodes.length, wide, vnfs: vnfs.get(id) ?? [] }));
    });
    for (const nodes of columns) {
        const its = nodes.flatMap((id) => boxes.get(id) ?? []);
        const room = Math.min(...its.map((box) => (high / nodes.length - height(box)) / 2 - MARGIN));
        const crossed = (/** @type {number} */ shift) => its.reduce((sum, box) => sum + crossings({ ...box, y: box.y + shift * room }, boxes, links), 0);
        const counted = SHIFTS.map((shift) => ({ shift, count: room > 0 || shift === 0 ? crossed(shift) : Infinity }));
        const best = counted.reduce((least, one) => (one.count < least.count ? one : least));
        for (const box of its) box.y += best.shift * room;
    }
    return boxes;
}

/**
 * Returns how many links pass behind a node.
 * @param {Box} box
 * @param {Map<string, Box>} boxes
 * @param {Link[]} links
 */
function crossings(box, boxes, links) {
    let count = 0;
    for (const { ends } of links) {
        if (ends.includes(box.id)) continue;
        const [one, other] = [boxes.get(ends[0]), boxes.get(ends[1])];
        if (!one || !other || Math.min(one.x, other.x) >= box.x || Math.max(one.x, other.x) <= box.x) continue;
        const slope = (other.y - one.y) / (other.x - one.x);
        const away = Math.abs(one.y + slope * (box.x - one.x) - box.y);
        if (away < height(box) / 2 + Math.abs(slope) * (box.wide / 2)) count += 1;
    }
    return count;
}

/**
 * Returns the VNF or the link at a place of the drawing; `null` for none.
 * @param {Iterable<Box>} boxes
 * @param {Link[]} links
 * @param {number} x
 * @param {number} y
 * @returns {{ vnf: string } | { link: string } | null}
 */
export function found(boxes, links, x, y) {
    /** @type {Map<string, Box>} */
    const by = new Map();
    for (const box of boxes) {
        by.set(box.id, box);
        const top = box.y - height(box) / 2;
        if (Math.abs(x - box.x) > box.wide / 2 || y < top || y > top + height(box)) continue;
        const vnf = box.vnfs[Math.floor((y - top - 4) / ROW) - 1];
        return vnf === undefined ? null : { vnf };
    }
    const distance = (/** @type {Link} */ { ends }) => {
        const [from, to] = ends.map((end) => by.get(end));
        if (!from || !to) return Infinity;
        const [dx, dy] = [to.x - from.x, to.y - from.y];
        const share = Math.min(1, Math.max(0, ((x - from.x) * dx + (y - from.y) * dy) / (dx * dx + dy * dy)));
        return Math.hypot(x - from.x - share * dx, y - from.y - share * dy);
    };
    const [nearest] = links.map((link) => ({ id: link.id, away: distance(link) })).sort((one, other) => one.away - other.away);
    return nearest && nearest.away <= NEAR ? { link: nearest.id } : null;
}

export class Topology {
    #drawn = "";
    #tellSoon = rarely(() => this.#tell());
    /** Nodes as they were drawn last. @type {Map<string, Box>} */
    #boxes = new Map();
    /** Key of the graph that their places follow from. */
    #placed = "";

    /**
     * @param {HTMLElement} host
     * @param {Model} model
     * @param {() => void} changed
     * @param {(what: { vnf: string } | { link: string }) => void} chosen
     */
    constructor(host, model, changed, chosen) {
        host.replaceChildren();
        this.model = model;
        this.columns = columns(model);
        this.canvas = new Canvas(host, "Topology", () => {
            this.#drawn = "";
            changed();
        });
        this.canvas.base.addEventListener("click", ({ offsetX, offsetY }) => {
            const what = found(this.#boxes.values(), links(this.model), offsetX, offsetY);
            if (what) chosen(what);
        });
    }

    /**
     * Shows a model of another time.
     * @param {Model} model
     */
    show(model) {
        this.model = model;
        this.#drawn = "";
    }

    /**
     * Draws the topology if something in it has changed.
     * @param {Palette} palette
     */
    draw(palette) {
        const { model, canvas } = this;
        if (canvas.width === 0) return;
        const units = [...model.robots.values()].map((robot) => robot.unit);
        const state = [model.version.network, units, palette.dark].join();
        if (state === this.#drawn) return;
        this.#drawn = state;
        const on = canvas.clear(canvas.base);
        on.font = FONT;
        on.textBaseline = "middle";
        on.textAlign = "center";
        const vnfs = vnfsByNode(model);
        const boxes = this.#place(vnfs);
        const used = carrying(model);
        const all = links(model);
        for (const link of all) if (!used.has(link.id)) this.#drawLink(on, boxes, link, palette.axis, 1);
        const inUse = all.filter(({ id }) => used.has(id));
        for (const link of inUse) this.#drawLink(on, boxes, link, palette.series[0], 2.5);
        for (const box of boxes.values()) this.#drawNode(on, box, palette);
        /** @type {Taken[]} */
        const taken = [];
        for (const link of inUse) this.#describe(on, boxes, link, palette, taken);
        this.#tellSoon();
    }

    /**
     * Returns the nodes with their places.
     * @param {Map<string, string[]>} vnfs
     */
    #place(vnfs) {
        const { width, height } = this.canvas;
        const of = JSON.stringify([width, height, [...vnfs]]);
        if (of !== this.#placed) {
            this.#placed = of;
            this.#boxes = places(this.columns, vnfs, wired(this.model), { width, height });
        }
        return this.#boxes;
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {Map<string, Box>} boxes
     * @param {Link} link
     * @param {string} colour
     * @param {number} width
     */
    #drawLink(on, boxes, { ends }, colour, width) {
        const [from, to] = [boxes.get(ends[0]), boxes.get(ends[1])];
        if (!from || !to) return;
        on.strokeStyle = colour;
        on.lineWidth = width;
        on.beginPath();
        on.moveTo(from.x, from.y);
        on.lineTo(to.x, to.y);
        on.stroke();
    }

    /**
     * @param {CanvasRenderingContext2D} on
     * @param {Box} box
     * @param {Palette} palette
     */
    #drawNode(on, box, palette) {
        const { id, x, y, wide, vnfs } = box;
        const high = height(box);
        const unit = this.model.units.indexOf(id);
        const [left, top] = [x - wide / 2, y - high / 2];
        on.fillStyle = palette.back;
        on.strokeStyle = vnfs.length > 0 ? palette.ink : palette.axis;
        on.lineWidth = 1;
        on.beginPath();
        on.roundRect(left, top, wide, high, 4);
        on.fill();
        on.stroke();
        if (unit >= 0) {
            on.fillStyle = BANDS[unit % BANDS.length];
            on.fillRect(left + 1, top + 4, 4, high - 8);
        }
        on.fillStyle = palette.ink;
        on.font = `bold ${FONT}`;
        on.fillText(short(id), x, top + 4 + ROW / 2, wide - 12);
        on.font = FONT;
        vnfs.forEach((vnf, i) => {
            const middle = top + 4 + ROW * (i + 1.5);
            on.fillStyle = faded(palette.series[2], 0.2);
            on.fillRect(left + 8, middle - ROW / 2 + 1, wide - 16, ROW - 2);
            on.fillStyle = palette.ink;
            on.fillText(short(vnf), x, middle, wide - 18);
        });
    }

    /**
     * Writes the figures of a link on it, where no node and no other figures are.
     * @param {CanvasRenderingContext2D} on
     * @param {Map<string, Box>} boxes
     * @param {Link} link
     * @param {Palette} palette
     * @param {Taken[]} taken Places of the figures so far; gets this one's.
     */
    #describe(on, boxes, { id, ends }, palette, taken) {
        const [from, to] = [boxes.get(ends[0]), boxes.get(ends[1])];
        if (!from || !to) return;
        const { delay, rate, loss, queue } = figures(this.model, id);
        const high = loss || queue ? 41 : 28;
        const at = (/** @type {number} */ share, [dx, dy] = BESIDE[0]) => ({ x: from.x + (to.x - from.x) * share + dx, y: from.y + (to.y - from.y) * share + dy, high });
        const isFree = (/** @type {Taken} */ { x, y }) =>
            taken.every((other) => Math.abs(other.x - x) > 80 || Math.abs(other.y - y) > Math.max(high, other.high)) &&
            [...boxes.values()].every((box) => Math.abs(box.x - x) > box.wide / 2 + 44 || Math.abs(box.y - y) > height(box) / 2 + 14);
        const place = BESIDE.flatMap((beside) => SHARES.map((share) => at(share, beside))).find(isFree) ?? at(0.5);
        taken.push(place);
        rimmed(on, delay, place.x, place.y - 7, palette.ink, palette.back);
        rimmed(on, rate, place.x, place.y + 6, palette.faint, palette.back);
        if (!loss && !queue) return;
        // Beside each other, each in its colour.
        const gap = loss && queue ? 8 : 0;
        const [ofLoss, ofQueue] = [loss, queue].map((text) => on.measureText(text).width);
        const left = place.x - (ofLoss + gap + ofQueue) / 2;
        rimmed(on, loss, left + ofLoss / 2, place.y + 19, palette.alert, palette.back);
        rimmed(on, queue, left + ofLoss + gap + ofQueue / 2, place.y + 19, palette.ink, palette.back);
    }

    #tell() {
        const placed = [...vnfsByNode(this.model)].map(([node, of]) => `${node}: ${of.join(", ")}`).join("; ");
        const paths = [...this.model.virtualLinks.values()].map(({ from, to, links: over }) => `${from} to ${to} over ${over.join(", ")}`);
        const label = `Topology: ${placed || "no VNFs"}; ${paths.join("; ") || "no virtual links"}`;
        if (this.canvas.base.getAttribute("aria-label") !== label) this.canvas.base.setAttribute("aria-label", label);
    }
}

/**
 * Returns the height of a node, pixels.
 * @param {Box} box
 */
const height = ({ vnfs }) => ROW * (1 + vnfs.length) + 8;

/**
 * Returns the figures of a link in words: d there and back, λ of both directions, what is lost, and the longer queue.
 * @param {Model} model
 * @param {string} link
 */
export function figures(model, link) {
    const [there, back] = ["forward", "backward"].map((direction) => model.links.get(`${link}:${direction}`));
    const delay = (/** @type {typeof there} */ of) => figure(of?.delay_ms ?? of?.probed?.delay_ms);
    const rate = (there?.throughput_bps ?? 0) + (back?.throughput_bps ?? 0);
    const loss = Math.max(there?.probed?.loss ?? 0, back?.probed?.loss ?? 0);
    const queued = Math.max(there?.queued_packets ?? 0, back?.queued_packets ?? 0);
    return {
        delay: `${delay(there)} / ${delay(back)} ms`,
        rate: figure(rate, "bit/s"),
        loss: loss > 0 ? `${(100 * loss).toFixed(1)} % lost` : "",
        queue: queued > 0 ? `${queued} queued` : "",
    };
}

const short = (/** @type {string} */ name) => (name.length > 16 ? `${name.slice(0, 15)}…` : name);
