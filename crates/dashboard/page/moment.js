// Another time than the present: the graph as it was then, while the run goes on.

import { byId, setText } from "./dom.js";
import { clock } from "./format.js";
import { Model } from "./state.js";

/** @typedef {import("#api").components["schemas"]} Schemas */

/**
 * Loads what was wanted last: one request at a time. Of what is wanted meanwhile, only the last is loaded.
 * @template T
 */
export class Latest {
    #busy = false;
    /** @type {{ key: number } | null} */
    #wanted = null;
    #turn = 0;

    /**
     * @param {(key: number) => Promise<T>} load
     * @param {(result: T, key: number) => void} loaded
     * @param {(error: unknown) => void} failed
     */
    constructor(load, loaded, failed) {
        this.load = load;
        this.loaded = loaded;
        this.failed = failed;
    }

    /** @param {number} key */
    want(key) {
        this.#wanted = { key };
        if (!this.#busy) void this.#run();
    }

    /** Drops what is under way. */
    forget() {
        this.#wanted = null;
        this.#turn += 1;
    }

    async #run() {
        this.#busy = true;
        while (this.#wanted) {
            const { key } = this.#wanted;
            this.#wanted = null;
            const turn = this.#turn;
            try {
                const result = await this.load(key);
                if (turn === this.#turn) this.loaded(result, key);
            } catch (error) {
                if (turn === this.#turn) this.failed(error);
            }
        }
        this.#busy = false;
    }
}

/**
 * Returns the model at an earlier time: a state of the graph, with the trails and service times until then.
 * @param {Model} live
 * @param {Schemas["GraphState"]} state
 * @param {number} at
 */
export function earlier(live, state, at) {
    const model = new Model(live.testbed);
    model.begin(state);
    model.now = at;
    for (const [id, robot] of model.robots) {
        const now = live.robots.get(id);
        robot.trail = now?.trail.filter((point) => point.at <= at) ?? [];
        const regions = now?.regions.filter((region) => region.from <= at) ?? [];
        robot.regions = regions.map((region) => ({ ...region, until: (region.until ?? Infinity) > at ? null : region.until }));
    }
    for (const { id } of live.testbed.services) {
        const name = `service_time:${id}`;
        model.figure(name).add(at, live.figure(name).valueAt(at).value);
    }
    return model;
}

/** The slider below the timeline's title, and the banner while it is not at its end. */
export class Moment {
    /** @type {Model | null} */
    #live = null;
    /** Seconds since the run began; `null` for the present. @type {number | null} */
    at = null;

    /**
     * @param {(at_ns: number) => Promise<Schemas["GraphState"]>} read
     * @param {(model: Model, at: number | null) => void} show
     */
    constructor(read, show) {
        this.show = show;
        this.slider = /** @type {HTMLInputElement} */ (byId("moment"));
        this.latest = new Latest(
            (at) => read(Math.round(at * 1e9)),
            (state, at) => {
                if (this.#live) this.show(earlier(this.#live, state, at), at);
                this.#tell("");
            },
            (error) => this.#tell(`: ${error instanceof Error ? error.message : error}`),
        );
        this.slider.addEventListener("input", () => this.#go(Number(this.slider.value)));
        byId("present").addEventListener("click", () => {
            this.#back();
            this.slider.focus();
        });
    }

    /**
     * Begins at the present of a model.
     * @param {Model} live
     */
    begin(live) {
        this.#live = live;
        this.#back();
    }

    /** Brings the slider up to date. */
    draw() {
        if (!this.#live) return;
        const { now } = this.#live;
        this.slider.max = String(now);
        if (this.at === null) this.slider.value = String(now);
        const words = this.at === null ? "now" : clock(this.at, 1);
        if (this.slider.getAttribute("aria-valuetext") !== words) this.slider.setAttribute("aria-valuetext", words);
    }

    /** @param {number} at */
    #go(at) {
        if (!this.#live || at >= Math.floor(this.#live.now * 2) / 2) {
            this.#back();
            return;
        }
        this.at = at;
        this.latest.want(at);
        this.#tell(" …");
    }

    #back() {
        const was = this.at;
        this.at = null;
        this.latest.forget();
        this.#tell("");
        if (this.#live && was !== null) this.show(this.#live, null);
    }

    /** @param {string} more */
    #tell(more) {
        byId("past").hidden = this.at === null;
        if (this.at !== null) setText(byId("past-at"), `Map, topology and robots at ${clock(this.at, 1)}${more}`);
        this.draw();
    }
}
