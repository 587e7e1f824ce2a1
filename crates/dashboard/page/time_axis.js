// The stretch of time that all charts show. It follows the present until somebody moves it.

const SHORTEST = 0.5;

export class TimeAxis {
    constructor() {
        /** Length in seconds; `null` for the whole run. @type {number | null} */
        this.span = 60;
        /** End in seconds; `null` for the present. @type {number | null} */
        this.end = null;
        /** Grows with each change. */
        this.version = 0;
    }

    /**
     * Returns the beginning and the end of the stretch.
     * @param {number} now
     */
    window(now) {
        const until = this.end ?? now;
        return { from: this.span === null ? Math.min(0, until - SHORTEST) : until - this.span, until };
    }

    get isLive() {
        return this.end === null;
    }

    /**
     * Shows the last seconds, or all of the run, and follows the present.
     * @param {number | null} span
     */
    follow(span = this.span) {
        [this.span, this.end] = [span, null];
        this.version += 1;
    }

    /**
     * Stands still at the present window.
     * @param {number} now
     */
    hold(now) {
        this.#set(this.window(now), now);
    }

    /**
     * Moves by a share of the shown stretch.
     * @param {number} share
     * @param {number} now
     */
    pan(share, now) {
        const { from, until } = this.window(now);
        const by = (until - from) * share;
        this.#set({ from: from + by, until: until + by }, now);
    }

    /**
     * Makes the shown stretch longer by a factor, around the place at a share of it. While it follows the present, its end
     * stays there.
     * @param {number} factor
     * @param {number} share
     * @param {number} now
     */
    zoom(factor, share, now) {
        const { from, until } = this.window(now);
        const span = Math.max(SHORTEST, Math.min((until - from) * factor, Math.max(60, now * 1.5)));
        if (this.isLive) {
            this.follow(span);
            return;
        }
        const at = from + (until - from) * share;
        this.#set({ from: at - span * share, until: at + span * (1 - share) }, now);
    }

    /**
     * Shows a stretch.
     * @param {number} from
     * @param {number} until
     * @param {number} now
     */
    show(from, until, now) {
        this.#set({ from, until: Math.max(until, from + SHORTEST) }, now);
    }

    /**
     * Shows a time in the middle.
     * @param {number} at
     * @param {number} now
     */
    centre(at, now) {
        const { from, until } = this.window(now);
        const half = Math.min((until - from) / 2, 30);
        this.#set({ from: at - half, until: at + half }, now);
    }

    /**
     * @param {{from: number, until: number}} window
     * @param {number} now
     */
    #set({ from, until }, now) {
        const span = until - from;
        // Some of the run stays in sight.
        const end = Math.min(Math.max(until, span * 0.1), now + span * 0.9);
        [this.span, this.end] = [span, end];
        this.version += 1;
    }
}
