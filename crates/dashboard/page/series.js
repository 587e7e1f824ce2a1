// A figure over time in bounded memory: recent samples as they are, and older ones in steps with their extremes. When there
// are too many steps, each two become one, so that a run of any length stays whole.

/** Samples that are kept as they are. */
const RECENT = 8192;
/** Steps of older samples. */
const STEPS = 2048;

export class Series {
    constructor() {
        this.times = new Float64Array(RECENT);
        this.values = new Float64Array(RECENT);
        this.length = 0;
        /** Ends of the steps, in order. */
        this.ends = new Float64Array(STEPS);
        this.lows = new Float64Array(STEPS);
        this.highs = new Float64Array(STEPS);
        this.lasts = new Float64Array(STEPS);
        this.steps = 0;
        /** Length of a step in seconds. */
        this.step = 0.2;
        /** Time of the last sample. */
        this.at = -Infinity;
    }

    /**
     * Adds a sample. NaN is a gap. A sample that is not newer than the last one is known already.
     * @param {number} at
     * @param {number} value
     */
    add(at, value) {
        if (!(at > this.at)) return;
        if (this.length === RECENT) this.#foldHalf();
        this.times[this.length] = at;
        this.values[this.length] = value;
        this.length += 1;
        this.at = at;
    }

    /**
     * Adds a step of the history, whose samples are older than all others that will be added.
     * @param {number} until
     * @param {number} low
     * @param {number} high
     * @param {number} last
     */
    addStep(until, low, high, last) {
        if (!(until > this.at)) return;
        this.#push(until, low, high, last);
        this.at = until;
    }

    /**
     * Adds what the history has of a figure.
     * @param {import("#api").components["schemas"]["Curve"]} curve
     */
    addCurve(curve) {
        for (const point of curve.points) {
            if ("count" in point) this.addStep(point.until_ns / 1e9, point.min, point.max, point.last);
            else this.addStep(point.until_ns / 1e9, NaN, NaN, NaN);
        }
    }

    /** The last value, or NaN. */
    get last() {
        if (this.length > 0) return this.values[this.length - 1];
        return this.steps > 0 ? this.lasts[this.steps - 1] : NaN;
    }

    /**
     * Calls `visit(time, low, high, last)` for what lies in a window, in order, with one neighbour on either side.
     * @param {number} from
     * @param {number} until
     * @param {(at: number, low: number, high: number, last: number) => void} visit
     */
    scan(from, until, visit) {
        const before = (/** @type {number} */ at) => Math.max(0, at - 1);
        for (let i = before(after(this.ends, this.steps, from)); i < this.steps; i++) {
            visit(this.ends[i], this.lows[i], this.highs[i], this.lasts[i]);
            if (this.ends[i] > until) return;
        }
        for (let i = before(after(this.times, this.length, from)); i < this.length; i++) {
            const value = this.values[i];
            visit(this.times[i], value, value, value);
            if (this.times[i] > until) return;
        }
    }

    /**
     * Reduces what lies in a window to points in columns of pixels, with one neighbour on either side.
     * @param {number} from
     * @param {number} until
     * @param {number} width Columns.
     * @param {number} longestGap Seconds without a sample above which the line is broken.
     * @param {Reduction} into
     */
    reduce(from, until, width, longestGap, into) {
        const place = (/** @type {Float64Array} */ ats, /** @type {number} */ length) =>
            [Math.max(0, after(ats, length, from) - 1), Math.min(length, after(ats, length, until) + 1)];
        into.begin(from, until, width, longestGap);
        const [[step, endStep], [sample, endSample]] = [place(this.ends, this.steps), place(this.times, this.length)];
        into.add({ ats: this.ends, lows: this.lows, highs: this.highs, lasts: this.lasts }, step, endStep);
        if (this.steps === 0 || this.ends[this.steps - 1] <= until) {
            const { times, values } = this;
            into.add({ ats: times, lows: values, highs: values, lasts: values }, sample, endSample);
        }
        into.end();
    }

    /**
     * Returns the value at a time, i.e. of the last sample until then, and its own time.
     * @param {number} at
     */
    valueAt(at) {
        const recent = after(this.times, this.length, at) - 1;
        if (recent >= 0) return { at: this.times[recent], value: this.values[recent] };
        const step = Math.min(after(this.ends, this.steps, at), this.steps - 1);
        return step >= 0 ? { at: this.ends[step], value: this.lasts[step] } : { at: NaN, value: NaN };
    }

    /**
     * Counts the samples of a window, and those up to a limit, of which samples without a value are none; `null` if some of
     * them are not here, or there are none.
     * @param {number} limit
     * @param {number} from
     * @param {number} until
     */
    countWithin(limit, from, until) {
        if (this.steps > 0 && this.ends[this.steps - 1] > from) return null;
        const [first, end] = [after(this.times, this.length, from), after(this.times, this.length, until)];
        let within = 0;
        for (let i = first; i < end; i++) if (this.values[i] <= limit) within += 1;
        return end > first ? { within, samples: end - first } : null;
    }

    /** Turns the older half of the samples into steps. */
    #foldHalf() {
        const half = this.length >> 1;
        let i = 0;
        while (i < half) {
            const end = this.times[i] + this.step;
            let [low, high, last, until] = [Infinity, -Infinity, NaN, this.times[i]];
            for (; i < half && this.times[i] < end; i++) {
                const value = this.values[i];
                until = this.times[i];
                if (Number.isNaN(value)) continue;
                [low, high, last] = [Math.min(low, value), Math.max(high, value), value];
            }
            if (Number.isNaN(last)) [low, high] = [NaN, NaN];
            this.#push(until, low, high, last);
        }
        this.times.copyWithin(0, half, this.length);
        this.values.copyWithin(0, half, this.length);
        this.length -= half;
    }

    /**
     * @param {number} until
     * @param {number} low
     * @param {number} high
     * @param {number} last
     */
    #push(until, low, high, last) {
        if (this.steps === STEPS) this.#mergePairs();
        this.ends[this.steps] = until;
        this.lows[this.steps] = low;
        this.highs[this.steps] = high;
        this.lasts[this.steps] = last;
        this.steps += 1;
    }

    #mergePairs() {
        this.steps >>= 1;
        for (let i = 0; i < this.steps; i++) {
            const [one, other] = [2 * i, 2 * i + 1];
            this.ends[i] = this.ends[other];
            this.lows[i] = least(this.lows[one], this.lows[other]);
            this.highs[i] = -least(-this.highs[one], -this.highs[other]);
            this.lasts[i] = Number.isNaN(this.lasts[other]) ? this.lasts[one] : this.lasts[other];
        }
        this.step *= 2;
    }
}

/**
 * A line as a few points in each column of pixels, however many samples there are. Its arrays stay for the next line: this is
 * most of a frame, so nothing is allocated and no function is called for a sample.
 */
export class Reduction {
    /** Places of the points, in columns from the left. */
    xs = new Float64Array(0);
    /** Values of the points; NaN is a gap. */
    values = new Float64Array(0);
    length = 0;
    /** The highest value of each column within the window. */
    highs = new Float64Array(0);
    columns = 0;
    /** Extremes of all columns within the window. */
    lowest = Infinity;
    highest = -Infinity;
    #from = 0;
    #scale = 0;
    #width = 0;
    #longestGap = 0;
    /** The column of the last samples, and the place of the first of them. */
    #column = NaN;
    #x = NaN;
    /** Extremes and last value of that column; NaN if it has none. */
    #low = NaN;
    #high = NaN;
    #last = NaN;
    /** Time of the last sample. */
    #before = NaN;
    /** Whether the line is broken behind the last sample. */
    #isBroken = false;

    /**
     * @param {number} from
     * @param {number} until
     * @param {number} width
     * @param {number} longestGap
     */
    begin(from, until, width, longestGap) {
        // A gap and three points in each column, and in those of the neighbours.
        const most = 4 * (Math.ceil(width) + 5);
        if (this.xs.length < most) [this.xs, this.values, this.highs] = [new Float64Array(most), new Float64Array(most), new Float64Array(most)];
        [this.#from, this.#scale, this.#width, this.#longestGap] = [from, width / (until - from), width, longestGap];
        [this.length, this.columns, this.lowest, this.highest] = [0, 0, Infinity, -Infinity];
        [this.#column, this.#low, this.#before, this.#isBroken] = [NaN, NaN, NaN, false];
    }

    /**
     * Adds samples in order, or steps with their extremes.
     * @param {{ ats: Float64Array, lows: Float64Array, highs: Float64Array, lasts: Float64Array }} of
     * @param {number} begin
     * @param {number} end
     */
    add({ ats, lows, highs, lasts }, begin, end) {
        const [from, scale, longestGap] = [this.#from, this.#scale, this.#longestGap];
        let [column, low, high, last, before, isBroken] = [this.#column, this.#low, this.#high, this.#last, this.#before, this.#isBroken];
        for (let i = begin; i < end; i++) {
            const at = ats[i];
            const value = lasts[i];
            const place = (at - from) * scale;
            if (Math.floor(place) !== column) {
                [this.#low, this.#high, this.#last] = [low, high, last];
                this.end();
                [column, low, high] = [Math.floor(place), NaN, NaN];
                this.#x = place;
            }
            if (Number.isNaN(value) || at - before > longestGap) isBroken = true;
            before = at;
            if (Number.isNaN(value)) continue;
            // Values of one column are together, whatever is between them.
            if (isBroken && Number.isNaN(low)) this.#push(place, NaN);
            isBroken = false;
            low = low <= lows[i] ? low : lows[i];
            high = high >= highs[i] ? high : highs[i];
            last = value;
        }
        [this.#column, this.#low, this.#high, this.#last, this.#before, this.#isBroken] = [column, low, high, last, before, isBroken];
    }

    /** Turns the column of the last samples into points. */
    end() {
        const [x, low, high] = [this.#x, this.#low, this.#high];
        if (Number.isNaN(low)) return;
        if (low !== high) {
            this.#push(x, low);
            this.#push(x, high);
        }
        this.#push(x, this.#last);
        this.#low = NaN;
        if (x < 0 || x > this.#width) return;
        this.highs[this.columns++] = high;
        if (low < this.lowest) this.lowest = low;
        if (high > this.highest) this.highest = high;
    }

    /**
     * @param {number} x
     * @param {number} value
     */
    #push(x, value) {
        this.xs[this.length] = x;
        this.values[this.length] = value;
        this.length += 1;
    }
}

/**
 * The lower of two numbers, of which one may be NaN.
 * @param {number} one
 * @param {number} other
 */
function least(one, other) {
    return Number.isNaN(one) ? other : Number.isNaN(other) ? one : Math.min(one, other);
}

/**
 * Returns the place of the first number that is above another, in numbers in order.
 * @param {Float64Array} sorted
 * @param {number} length
 * @param {number} value
 */
function after(sorted, length, value) {
    let [low, high] = [0, length];
    while (low < high) {
        const middle = (low + high) >> 1;
        if (sorted[middle] > value) high = middle;
        else low = middle + 1;
    }
    return low;
}
