// A closer look at the past. Of what was before the page was opened, or long ago, the page has steps with their extremes. When
// charts stand still at a short stretch of it, that stretch is read again, in as many points.

import { Latest } from "./moment.js";
import { Series } from "./series.js";

/** @typedef {import("#api").components["schemas"]} Schemas */
/** @typedef {import("./state.js").Model} Model */
/** @typedef {{ from: number, until: number }} Stretch Seconds since the run began. */

/** Pause after the last change of the shown stretch, ms. */
const PAUSE = 250;

/**
 * Returns the figures that are only known in steps within a stretch.
 * @param {Model} model
 * @param {string[]} figures
 * @param {Stretch} stretch
 */
export function coarse(model, figures, { from, until }) {
    const isCoarse = (/** @type {string} */ name) => {
        const { steps, ends } = model.figure(name);
        return steps > 0 && ends[steps - 1] > from && ends[0] < until;
    };
    // These are not of the API.
    return figures.filter((name) => !/^(split|other):/.test(name) && isCoarse(name));
}

export class Details {
    #timer = 0;
    /** @type {{ figures: string[], stretch: Stretch }} */
    #wanted = { figures: [], stretch: { from: 0, until: 0 } };

    /**
     * @param {Model} model
     * @param {(figure: string, stretch: Stretch) => Promise<Schemas["Curve"]>} read
     * @param {() => void} changed
     */
    constructor(model, read, changed) {
        this.model = model;
        const load = async () => {
            const { figures, stretch } = this.#wanted;
            /** @type {Map<string, Series>} */
            const found = new Map();
            for (const name of figures) {
                const series = new Series();
                series.addCurve(await read(name, stretch));
                found.set(name, series);
            }
            return { ...stretch, series: found };
        };
        const loaded = (/** @type {NonNullable<Model["detail"]>} */ detail) => {
            model.detail = detail;
            changed();
        };
        // The steps stay. The connection's state says why.
        this.latest = new Latest(load, loaded, () => {});
    }

    /**
     * Reads these figures within a stretch, and half as much on either side, unless that is known already.
     * @param {string[]} figures
     * @param {Stretch} stretch
     */
    want(figures, { from, until }) {
        clearTimeout(this.#timer);
        this.#timer = setTimeout(() => {
            const [needed, { detail }] = [coarse(this.model, figures, { from, until }), this.model];
            const isKnown = detail && detail.from <= from && detail.until >= until && until - from > (detail.until - detail.from) / 4;
            if (needed.length === 0 || (isKnown && needed.every((name) => detail.series.has(name)))) return;
            const more = (until - from) / 2;
            // Not beyond the present, whose samples come by themselves.
            const end = Math.min(until + more, this.model.now);
            this.#wanted = { figures: needed, stretch: { from: Math.max(0, from - more), until: end } };
            this.latest.want(from);
        }, PAUSE);
    }
}
