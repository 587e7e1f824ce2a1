// Radio coverage on the map: circles of equal mean signal around radio units, on demand.

import { element } from "./dom.js";
import { Refused } from "./api.js";

/** @typedef {import("#api").components["schemas"]["CoverageBody"]} Coverage */
/** @typedef {{ x: number, y: number }} Point */
/**
 * @typedef {object} Ring A circle in a view, in pixels.
 * @property {string} unit
 * @property {number} signal Mean signal on it, dBm.
 * @property {number} x
 * @property {number} y
 * @property {number} radius
 * @property {Point | null} label Middle of its label; `null` where none has room.
 */

/** Room of a label, pixels. */
const WIDTH = 30;
const HEIGHT = 14;
/** Distance of a label from the middle of a radio unit, which is drawn with its name. */
const CLEAR = 30;
/** Directions from the radio unit in which labels can stand, the best first. */
const DIRECTIONS = [0, 4, 8, 12, 2, 6, 10, 14, 1, 3, 5, 7, 9, 11, 13, 15].map((sixteenth) => (sixteenth * Math.PI) / 8);

export const LEGEND = "Coverage in dBm: mean signal, without walls";

/**
 * Returns the rings that a view shows, the widest first, with places for their labels. A label stands where no other radio unit
 * is stronger.
 * @param {Coverage[]} coverage
 * @param {(unit: string) => Point | null} place Where a radio unit is in the view; `null` if it has no place.
 * @param {number} scale Pixels to the metre.
 * @param {{ width: number, height: number }} view
 * @returns {Ring[]}
 */
export function rings(coverage, place, scale, { width, height }) {
    const units = coverage.flatMap(({ radio_unit, circles }) => {
        const at = place(radio_unit);
        return at ? [{ unit: radio_unit, at, circles: circles.map(({ signal_dbm, radius_m }) => ({ signal: signal_dbm, radius: radius_m * scale })) }] : [];
    });
    const all = units.flatMap(({ unit, at, circles }) => {
        const nearest = Math.hypot(Math.max(-at.x, 0, at.x - width), Math.max(-at.y, 0, at.y - height));
        const farthest = Math.hypot(Math.max(at.x, width - at.x), Math.max(at.y, height - at.y));
        return circles.filter(({ radius }) => radius > nearest && radius < farthest).map((circle) => ({ unit, ...at, ...circle }));
    });
    /** @type {Point[]} */
    const taken = [];
    const isFree = (/** @type {Point} */ { x, y }) =>
        x > WIDTH / 2 && x < width - WIDTH / 2 && y > 2 * HEIGHT && y < height - HEIGHT &&
        taken.every((other) => Math.abs(other.x - x) > WIDTH || Math.abs(other.y - y) > HEIGHT) &&
        units.every(({ at }) => Math.hypot(at.x - x, at.y - y) > CLEAR);
    const labelled = all.map((ring) => {
        const isStrongest = (/** @type {Point} */ { x, y }) => units.every(({ unit, at, circles }) => {
            const other = circles.findLast(({ signal }) => signal >= ring.signal);
            return unit === ring.unit || !other || Math.hypot(at.x - x, at.y - y) >= other.radius;
        });
        const places = DIRECTIONS.map((angle) => ({ x: ring.x + ring.radius * Math.cos(angle), y: ring.y - ring.radius * Math.sin(angle) }));
        const label = places.find((at) => isFree(at) && isStrongest(at)) ?? null;
        if (label) taken.push(label);
        return { ...ring, label };
    });
    return labelled.sort((one, other) => other.radius - one.radius);
}

/** A button that shows the coverage while it is pressed. It is read once. */
export class CoverageButton {
    /** @type {Coverage[] | null} */
    #known = null;

    /**
     * @param {HTMLElement} tools
     * @param {import("./state.js").Model} model
     * @param {() => Promise<Coverage[]>} read
     * @param {(coverage: Coverage[], legend: string) => void} show
     */
    constructor(tools, model, read, show) {
        this.read = read;
        this.show = show;
        if (model.units.length === 0) return;
        this.button = element("button", {
            type: "button", "aria-pressed": "false", title: "Show the mean signal of radio units, without walls", click: () => void this.#toggle(),
        }, "Coverage");
        tools.append(this.button);
    }

    get #isPressed() {
        return this.button?.getAttribute("aria-pressed") === "true";
    }

    async #toggle() {
        this.button?.setAttribute("aria-pressed", String(!this.#isPressed));
        if (!this.#isPressed) return this.show([], "");
        let legend = LEGEND;
        try {
            this.#known ??= await this.read();
        } catch (error) {
            legend = error instanceof Refused ? `No coverage: ${error.message}` : "No coverage: the run does not answer";
        }
        if (this.#isPressed) this.show(this.#known ?? [], legend);
    }
}
