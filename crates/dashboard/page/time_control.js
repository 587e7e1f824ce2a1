// Stops the run's time, takes it on by steps, and changes its speed, where it is not real time.

import { element, setText } from "./dom.js";

/** @typedef {import("#api").components["schemas"]["ClockBody"]} Clock */
/** @typedef {import("#api").components["schemas"]["ClockChangeBody"]} ClockChange */

/** Seconds of the run per second. @type {Clock["speed"][]} */
const SPEEDS = [0.1, 0.5, 1, 2, 5, 10, 50, "max"];
/** A step, milliseconds of the run: the interval of κ. */
const STEP_MS = 100;

/**
 * Returns the speeds to choose from, with the present one in its place.
 * @param {Clock["speed"]} present
 */
export function speeds(present) {
    if (SPEEDS.includes(present)) return SPEEDS;
    return [...SPEEDS, present].sort((one, other) => Number(one === "max") - Number(other === "max") || Number(one) - Number(other));
}

/** @param {Clock["speed"]} speed */
const named = (speed) => (speed === "max" ? "as fast as possible" : `${speed}×`);

export class TimeControl {
    /**
     * @param {HTMLElement} host
     * @param {(change: ClockChange) => Promise<Clock>} change
     * @param {(error: unknown) => void} failed
     */
    constructor(host, change, failed) {
        const give = async (/** @type {ClockChange} */ wanted) => {
            try {
                this.show(await change(wanted));
            } catch (error) {
                failed(error);
            }
        };
        this.host = host;
        this.paused = false;
        this.pause = element("button", { type: "button", "aria-pressed": "false", click: () => give({ paused: !this.paused }) }, "Pause");
        this.step = element("button", { type: "button", title: `Go on for ${STEP_MS / 1000} s, and stop`, click: () => give({ step_ms: STEP_MS }) }, "Step");
        this.speed = element("select", {
            "aria-label": "Speed of the run's time", title: "Seconds of the run per second",
            change: () => give({ speed: this.speed.value === "max" ? "max" : Number(this.speed.value) }),
        });
        host.replaceChildren(this.pause, this.step, this.speed);
    }

    /**
     * Shows how time passes.
     * @param {Clock} clock
     */
    show({ controllable, paused, speed }) {
        this.host.hidden = !controllable;
        this.paused = paused;
        this.pause.setAttribute("aria-pressed", String(paused));
        setText(this.pause, paused ? "Go on" : "Pause");
        const options = speeds(speed).map((each) => element("option", { value: String(each) }, named(each)));
        this.speed.replaceChildren(...options);
        this.speed.value = String(speed);
    }
}
