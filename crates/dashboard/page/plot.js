// Draws figures over time on a canvas, and as SVG. Knows no element and no state: what is drawn is an argument.
//
// A line has at most four points in each column of pixels, however many samples there are.

import { DASHES, faded } from "./palette.js";
import { clock, figure, ticks, timeTicks } from "./format.js";
import { FONT } from "./canvas.js";
import { Raster } from "./raster.js";
import { Reduction } from "./series.js";

/** @typedef {import("./series.js").Series} Series */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {{ name: string, series: Series, index: number }} Line */
/** @typedef {{ from: number, until: number, index: number, name: string }} Band */
/** @typedef {{ at: number, bad: boolean }} Mark */
/**
 * @typedef {object} Plot
 * @property {number} from
 * @property {number} until
 * @property {Line[]} lines
 * @property {Band[]} bands
 * @property {Mark[]} marks
 * @property {number | null} target
 * @property {string} unit
 * @property {boolean} fromZero Whether the axis begins at zero.
 * @property {number | null} longestGap Seconds without a sample above which a line is broken.
 */

const LEFT = 46;
const RIGHT = 10;
const TOP = 16;
const BOTTOM = 18;
/** Values beyond this share of all columns are clipped if they are far above the rest. */
const MOST = 0.97;

const raster = typeof OffscreenCanvas === "undefined" ? null : new Raster();

/** A drawing surface: that of a canvas, or {@link Svg}. @typedef {CanvasRenderingContext2D | Svg} Surface */

/**
 * Returns the place of a plot's axes in a canvas of this size.
 * @param {number} width
 * @param {number} height
 */
export function area(width, height) {
    return { left: LEFT, right: Math.max(LEFT + 1, width - RIGHT), top: TOP, bottom: Math.max(TOP + 1, height - BOTTOM) };
}

/**
 * Reduces the lines of a plot to points in columns of pixels. The result holds until the next call.
 * @param {Plot} plot
 * @param {number} width Columns.
 */
export function reduce(plot, width) {
    while (reductions.length < plot.lines.length) reductions.push(new Reduction());
    return plot.lines.map(({ series }, i) => {
        series.reduce(plot.from, plot.until, width, plot.longestGap ?? Infinity, reductions[i]);
        return reductions[i];
    });
}

/** @type {Reduction[]} */
const reductions = [];

/**
 * Returns the range of the axis. A few values far above all others do not decide it: they are clipped, and marked.
 * @param {Plot} plot
 * @param {Reduction[]} lines
 */
export function range(plot, lines) {
    const { lowest, highest, usual } = extremes(lines);
    let [low, high] = [lowest, highest];
    const floor = plot.target ?? 0;
    if (plot.fromZero) {
        low = Math.min(0, low);
        const most = Math.max(usual, floor) * 1.3;
        if (high > most * 1.6) high = most;
        high = Math.max(high, floor * 1.25);
    }
    if (!(high > low)) [low, high] = [low - (low === 0 ? 0 : 1), low + 1];
    const pad = (high - low) * 0.08;
    const { step } = ticks(low, high, 4);
    const round = step / 2;
    return {
        low: plot.fromZero && low === 0 ? 0 : Math.floor((low - pad) / round) * round,
        high: Math.ceil((high + pad) / round) * round,
    };
}

/**
 * Returns the lowest and the highest value of all lines, and the one that a share of all columns keep, to 1/256 of the range.
 * @param {Reduction[]} lines
 */
function extremes(lines) {
    const lowest = Math.min(...lines.map((line) => line.lowest));
    const highest = Math.max(...lines.map((line) => line.highest));
    if (!(highest >= lowest)) return { lowest: 0, highest: 1, usual: 1 };
    const bins = new Uint32Array(BINS);
    const binScale = BINS / (highest - lowest || 1);
    let count = 0;
    for (const { highs, columns } of lines) {
        for (let i = 0; i < columns; i++) bins[Math.min(BINS - 1, Math.floor((highs[i] - lowest) * binScale))] += 1;
        count += columns;
    }
    let [bin, seen] = [0, 0];
    while (bin < BINS - 1 && (seen += bins[bin]) < count * MOST) bin += 1;
    return { lowest, highest, usual: Math.min(highest, lowest + (bin + 1) / binScale) };
}

const BINS = 256;

/**
 * Draws a plot.
 * @param {Surface} on
 * @param {number} width
 * @param {number} height
 * @param {Plot} plot
 * @param {Palette} palette
 */
export function draw(on, width, height, plot, palette) {
    const { left, right, top, bottom } = area(width, height);
    const density = on instanceof Svg ? 1 : on.getTransform().a;
    const lines = reduce(plot, Math.ceil((right - left) * density));
    const { low, high } = range(plot, lines);
    const xOf = (/** @type {number} */ at) => left + ((at - plot.from) / (plot.until - plot.from)) * (right - left);
    const yOf = (/** @type {number} */ value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    on.font = FONT;
    on.textBaseline = "middle";

    for (const band of plot.bands) {
        const from = Math.max(left, xOf(band.from));
        const until = Math.min(right, xOf(band.until));
        if (until <= from) continue;
        const colour = palette.bands[band.index % palette.bands.length];
        on.fillStyle = faded(colour, palette.dark ? 0.12 : 0.15);
        on.fillRect(from, top, until - from, bottom - top);
        on.fillStyle = faded(colour, palette.dark ? 0.5 : 0.55);
        on.fillRect(from, 1, until - from, top - 3);
        if (until - from > 10 + 7 * band.name.length) {
            on.fillStyle = palette.ink;
            on.textAlign = "center";
            on.fillText(band.name, (from + until) / 2, top / 2 + 0.5);
        }
    }

    const rows = ticks(low, high, Math.max(3, Math.floor((bottom - top) / 30)));
    on.lineWidth = 1;
    on.textAlign = "right";
    for (const value of rows.places) {
        const y = Math.round(yOf(value)) + 0.5;
        if (y < top - 1 || y > bottom + 1) continue;
        stroke(on, palette.grid, [left, y, right, y]);
        on.fillStyle = palette.faint;
        on.fillText(axisLabel(value, plot.unit, rows.step), left - 6, y);
    }
    const columns = timeTicks(plot.from, plot.until, Math.max(2, Math.floor((right - left) / 90)));
    on.textAlign = "center";
    for (const at of columns.places) {
        const x = Math.round(xOf(at)) + 0.5;
        stroke(on, palette.grid, [x, top, x, bottom]);
        on.fillStyle = palette.faint;
        if (at >= 0) on.fillText(clock(at, columns.step < 1 ? 1 : 0), Math.min(x, right - 12), bottom + 10);
    }
    stroke(on, palette.axis, [left, bottom + 0.5, right, bottom + 0.5]);

    for (const mark of plot.marks) {
        const x = Math.round(xOf(mark.at)) + 0.5;
        if (x < left || x > right) continue;
        on.setLineDash([2, 3]);
        stroke(on, mark.bad ? palette.alert : palette.faint, [x, top - 2, x, bottom]);
        on.setLineDash([]);
    }

    const clipped = on instanceof Svg || !raster
        ? strokeLines(on, plot, lines, palette, { left, right, top, bottom, low, high, density })
        : rasterLines(on, raster, plot, lines, palette, { left, right, top, bottom, low, high, density });
    for (const { x, index } of clipped) {
        on.fillStyle = palette.series[index];
        on.beginPath();
        on.moveTo(x - 3, top + 4);
        on.lineTo(x + 3, top + 4);
        on.lineTo(x, top - 1);
        on.fill();
    }

    if (plot.target !== null && plot.target <= high) {
        const y = Math.round(yOf(plot.target)) + 0.5;
        on.setLineDash([5, 4]);
        on.lineWidth = 1.2;
        stroke(on, palette.alert, [left, y, right, y]);
        on.setLineDash([]);
        on.fillStyle = palette.alert;
        on.textAlign = "right";
        on.fillText(`target ${figure(plot.target, plot.unit)}`, right - 2, y - 7);
    }
    return { low, high, left, right, top, bottom };
}

/** @typedef {{ left: number, right: number, top: number, bottom: number, low: number, high: number, density: number }} Frame */
/** @typedef {{ x: number, index: number }[]} Clipped Places of values above the axis. */

/**
 * Draws the lines as paths.
 * @param {Surface} on
 * @param {Plot} plot
 * @param {Reduction[]} lines
 * @param {Palette} palette
 * @param {Frame} frame
 */
function strokeLines(on, plot, lines, palette, { left, right, top, bottom, low, high, density }) {
    /** @type {Clipped} */
    const clipped = [];
    on.save();
    on.beginPath();
    on.rect(left, top - 1, right - left, bottom - top + 2);
    on.clip();
    on.lineJoin = "round";
    on.lineWidth = 1.5;
    const scale = (bottom - top) / (high - low);
    for (const [at, { xs, values, length }] of lines.entries()) {
        const index = plot.lines[at].index % palette.series.length;
        on.strokeStyle = palette.series[index];
        on.setLineDash(DASHES[index]);
        on.beginPath();
        let drawn = false;
        for (let i = 0; i < length; i++) {
            const [x, value] = [left + xs[i] / density, values[i]];
            if (Number.isNaN(value)) {
                drawn = false;
                continue;
            }
            const y = bottom - (value - low) * scale;
            if (value > high && x >= left && x <= right) clipped.push({ x, index });
            if (!drawn) on.moveTo(x - 0.7, y);
            on.lineTo(x, y);
            drawn = true;
        }
        on.stroke();
    }
    on.setLineDash([]);
    on.restore();
    return clipped;
}

/**
 * Draws the lines as pixels.
 * @param {CanvasRenderingContext2D} on
 * @param {Raster} raster
 * @param {Plot} plot
 * @param {Reduction[]} lines
 * @param {Palette} palette
 * @param {Frame} frame
 */
function rasterLines(on, raster, plot, lines, palette, { left, right, top, bottom, low, high, density }) {
    /** @type {Clipped} */
    const clipped = [];
    const [width, height] = [Math.ceil((right - left) * density), Math.ceil((bottom - top) * density)];
    raster.begin(width, height);
    const scale = ((bottom - top) * density) / (high - low);
    for (const [at, points] of lines.entries()) {
        const { xs, values, length } = points;
        const index = plot.lines[at].index % palette.series.length;
        for (let i = 0; i < length; i++) {
            const value = values[i];
            if (value > high && xs[i] >= 0 && xs[i] <= width) clipped.push({ x: left + xs[i] / density, index });
            // From here on, they are rows of pixels.
            values[i] = (high - value) * scale;
        }
        raster.line(points, palette.series[index], DASHES[index], density);
    }
    raster.copy(on, left, top, width / density, height / density);
    return clipped;
}

/**
 * @param {number} value
 * @param {string} unit
 * @param {number} step
 */
function axisLabel(value, unit, step) {
    if (unit === "bit/s" || unit === "bytes") return figure(value, unit).replace(/bit\/s$/, "bit/s");
    const decimals = Math.max(0, Math.min(4, -Math.floor(Math.log10(step) + 1e-9)));
    return value.toFixed(decimals).replace("-", "−");
}

/**
 * @param {Surface} on
 * @param {string} colour
 * @param {number[]} points
 */
function stroke(on, colour, [x1, y1, x2, y2]) {
    on.strokeStyle = colour;
    on.beginPath();
    on.moveTo(x1, y1);
    on.lineTo(x2, y2);
    on.stroke();
}

/** A surface that keeps what is drawn as the text of an SVG picture. */
export class Svg {
    font = FONT;
    /** @type {string} */ textBaseline = "middle";
    /** @type {string} */ textAlign = "left";
    /** @type {string} */ lineJoin = "round";
    fillStyle = "#000000";
    strokeStyle = "#000000";
    lineWidth = 1;
    #dash = /** @type {number[]} */ ([]);
    #path = "";
    #rect = "";
    #clip = "";
    #clips = 0;
    #parts = /** @type {string[]} */ ([]);

    /** @param {number[]} dash */
    setLineDash(dash) {
        this.#dash = dash;
    }
    save() {
        this.#clip = "";
    }
    restore() {
        this.#clip = "";
    }
    beginPath() {
        this.#path = "";
    }
    /**
     * @param {number} x
     * @param {number} y
     */
    moveTo(x, y) {
        this.#path += `M${short(x)} ${short(y)}`;
    }
    /**
     * @param {number} x
     * @param {number} y
     */
    lineTo(x, y) {
        this.#path += `L${short(x)} ${short(y)}`;
    }
    /**
     * @param {number} x
     * @param {number} y
     * @param {number} width
     * @param {number} height
     */
    rect(x, y, width, height) {
        this.#rect = `<rect x="${short(x)}" y="${short(y)}" width="${short(width)}" height="${short(height)}"/>`;
    }
    clip() {
        this.#clips += 1;
        this.#parts.push(`<clipPath id="clip${this.#clips}">${this.#rect}</clipPath>`);
        this.#clip = ` clip-path="url(#clip${this.#clips})"`;
    }
    stroke() {
        const dash = this.#dash.length > 0 ? ` stroke-dasharray="${this.#dash.join(" ")}"` : "";
        const pen = `fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-linejoin="round"`;
        this.#parts.push(`<path d="${this.#path}" ${pen}${dash}${this.#clip}/>`);
    }
    fill() {
        this.#parts.push(`<path d="${this.#path}Z" fill="${this.fillStyle}"/>`);
    }
    /**
     * @param {number} x
     * @param {number} y
     * @param {number} width
     * @param {number} height
     */
    fillRect(x, y, width, height) {
        const size = `width="${short(width)}" height="${short(height)}"`;
        this.#parts.push(`<rect x="${short(x)}" y="${short(y)}" ${size} fill="${this.fillStyle}"/>`);
    }
    /**
     * @param {string} text
     * @param {number} x
     * @param {number} y
     */
    fillText(text, x, y) {
        const anchor = this.textAlign === "right" ? "end" : this.textAlign === "center" ? "middle" : "start";
        const place = `x="${short(x)}" y="${short(y)}" text-anchor="${anchor}" dominant-baseline="central"`;
        this.#parts.push(`<text ${place} fill="${this.fillStyle}">${escaped(text)}</text>`);
    }

    /**
     * Returns the picture.
     * @param {number} width
     * @param {number} height
     * @param {string} back
     */
    text(width, height, back) {
        const head = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${width} ${height}" width="${width}" height="${height}"`;
        const paper = `<rect width="${width}" height="${height}" fill="${back}"/>`;
        return `${head} font-family="sans-serif" font-size="11">${paper}${this.#parts.join("")}</svg>\n`;
    }
}

const short = (/** @type {number} */ value) => String(Math.round(value * 100) / 100);

const escaped = (/** @type {string} */ text) =>
    text.replace(/[&<>"]/g, (letter) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[letter] ?? letter);
